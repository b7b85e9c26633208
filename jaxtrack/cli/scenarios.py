"""The command `jaxtrack scenarios`: what can be compared.

>>> from jaxtrack.cli import scenarios
>>> scenarios.setting("clutter_rate", 20.0)
'clutter_rate=20'
"""

from typing import Any

from rich.console import Console
from rich.padding import Padding

from jaxtrack.cli import common


def scenarios() -> None:
    """List the scenarios, their trackers and what can be set in them."""
    common.start_jax(64)
    from jaxtrack import scenarios as every
    from jaxtrack.study import sweep

    console = Console(highlight=False)
    for name in every.MAKERS:
        scenario = every.make(name)
        known = sweep.parameters(name).items()
        settings = [setting(key, parameter.default) for key, parameter in known]
        console.print(f"[bold]{name}[/bold]  {scenario.summary}")
        for what, items in (("trackers", scenario.trackers), ("settings", settings)):
            console.print(Padding(f"{what}: {', '.join(items)}", (0, 0, 0, 2)))


def setting(name: str, value: Any) -> str:
    """Returns a setting and its default as text."""
    return f"{name}={value:g}" if isinstance(value, float | int) else f"{name}={value}"
