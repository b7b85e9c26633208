"""The command `jaxtrack config`: a template of settings for `jaxtrack track`.

>>> from jaxtrack.cli import config
>>> config.text(harbour=False).splitlines()[4]
'[file]'
"""

from typing import Annotated

import typer

from jaxtrack.cli import common


def config(
    harbour: Annotated[
        bool, typer.Option("--harbour", help="Those for the harbour instead.")
    ] = False,
) -> None:
    """Print a template of settings for `jaxtrack track --config FILE.toml`."""
    common.start_jax(64)
    typer.echo(text(harbour), nl=False)


def text(harbour: bool) -> str:
    """Returns the template, or the settings for New York harbour."""
    from jaxtrack.recorded import reading

    return reading.text("harbour" if harbour else "template")
