"""What all commands share: errors in one sentence, and how jax is started.

>>> import pathlib, tempfile
>>> from jaxtrack.cli import common
>>> common.names("gm-phd, gnn,")
['gm-phd', 'gnn']
>>> common.writable(pathlib.Path(tempfile.mkdtemp(), "out")).is_dir()
True
"""

import contextlib
import importlib.util
import os
import pathlib
import sys
import tempfile
from collections.abc import Iterator
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup


class Commands(TyperGroup):
    """The commands; what is wrong with their arguments is said in one sentence."""

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Runs a command and exits, with code 2 if the input was bad."""
        if not standalone_mode:
            return super().main(*args, standalone_mode=False, **extra)
        try:
            code = super().main(*args, standalone_mode=False, **extra)
        except typer.Abort:
            sys.exit(130)
        except Exception as error:
            # Releases of typer differ in the class of this error, not in its method.
            message = getattr(error, "format_message", None)
            if message is None:
                raise
            say("Error: " + " ".join(message().split()))
            sys.exit(2)
        sys.exit(code if isinstance(code, int) else 0)


def say(message: str) -> None:
    """Prints a sentence on stderr."""
    typer.echo(message, err=True)


def fail(message: str) -> NoReturn:
    """Says what is wrong, in one sentence, and exits with code 2."""
    say(f"Error: {message.rstrip('.')}.")
    raise typer.Exit(2)


@contextlib.contextmanager
def bad_input(*kinds: type[Exception]) -> Iterator[None]:
    """Turns errors of these kinds, which are about the input, into `fail`."""
    try:
        yield
    except kinds as error:
        fail(" ".join(str(error).split()))


def start_jax(precision: int) -> None:
    """Starts jax with a device for each core, and keeps what it compiles.

    `jaxtrack.start` says which environment variables change this; JAXTRACK_FUSION=1
    asks for its experiment, `start.fusion`.

    Args:
        precision: Bits of a float, 32 or 64.
    """
    if precision not in (32, 64):
        fail(f"precision is {precision}; give 32 or 64")
    from jaxtrack import start

    start.cores()
    if os.environ.get("JAXTRACK_FUSION", "0") != "0":
        with bad_input(RuntimeError):
            start.fusion()
    start.cache()
    import jax

    jax.config.update("jax_enable_x64", precision == 64)


def need(*modules: str) -> None:
    """Fails before the work begins if something that it needs is not installed."""
    for module in modules:
        if importlib.util.find_spec(module) is None:
            fail(f'{module} is not installed; pip install "jaxtrack[cli,plot,io]"')


def writable(directory: pathlib.Path) -> pathlib.Path:
    """Makes a directory, or fails if nothing can be written there."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        fail(f"cannot write in {directory} ({error.strerror}); give another --out")
    return directory


def names(text: str) -> list[str]:
    """Splits names at commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def whole(text: str | int) -> int:
    """Reads a whole number of the command line."""
    try:
        return int(text)
    except ValueError:
        remedy = "give digits only"
        raise typer.BadParameter(f"{text!r} is no whole number; {remedy}") from None
