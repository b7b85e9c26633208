"""A progress bar for a fit, with the loss beside it.

>>> from jaxtrack.learn import bar
>>> bar.text(12.34567)
'loss 12.346'

The bar is drawn by rich, on stderr, and only where that is a terminal or a notebook.
"""

import contextlib
import importlib
from collections.abc import Iterator
from typing import Any

from jaxtrack.learn.loop import Progress


@contextlib.contextmanager
def progress_bar(console: Any = None) -> Iterator[Progress]:
    """Draws a bar while a fit runs: what `learn.fit(progress=...)` takes.

    Args:
        console: Where to draw, a `rich.console.Console`; stderr if None.

    Raises:
        RuntimeError: rich is not installed.
    """
    try:
        rich = importlib.import_module("rich.console")
        progress = importlib.import_module("rich.progress")
    except ModuleNotFoundError as error:
        raise RuntimeError(
            'A progress bar needs rich: pip install "jaxtrack[cli]", or give '
            "`progress` a function of your own."
        ) from error
    console = rich.Console(stderr=True) if console is None else console
    columns = (
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("steps, {task.description}"),
        progress.TimeElapsedColumn(),
    )
    shown = console.is_terminal or console.is_jupyter
    with progress.Progress(*columns, console=console, disable=not shown) as drawn:
        task = drawn.add_task(text(float("nan")), total=None)

        def step(done: int, total: int, loss: float) -> None:
            drawn.update(task, completed=done, total=total, description=text(loss))

        yield step


def text(loss: float) -> str:
    """Returns what is written beside the bar."""
    return f"loss {loss:.5g}"
