"""The command `jaxtrack`, thin: each command is a module here, the work is elsewhere.

>>> from typer.testing import CliRunner
>>> from jaxtrack.cli import app
>>> CliRunner().invoke(app, ["--version"]).output.split()[0]
'jaxtrack'
"""

import importlib
from typing import Annotated

try:
    import rich as rich
    import typer
except ModuleNotFoundError as missing:
    raise SystemExit(
        f'The command line needs {missing.name}: pip install "jaxtrack[cli]".'
    ) from missing

from jaxtrack.cli import common, compare, config, follow, scenarios, track

app = typer.Typer(
    cls=common.Commands, add_completion=False, pretty_exceptions_enable=False
)
app.command("scenarios")(scenarios.scenarios)
app.command("compare")(compare.compare)
app.command("follow")(follow.follow)
app.command("track")(track.track)
app.command("config")(config.config)


@app.callback(invoke_without_command=True)
def main(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print it.")] = False,
) -> None:
    """Tracks many targets: simulated, to compare trackers, or recorded."""
    if version:
        typer.echo(f"jaxtrack {importlib.import_module('jaxtrack').__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())
