"""The command `jaxtrack compare`: trackers side by side over many simulated runs.

>>> from jaxtrack.cli import compare
>>> compare.parse_settings(["clutter_rate=20,60", "detect_prob=0.9"])
{'clutter_rate': [20.0, 60.0], 'detect_prob': [0.9]}
"""

import contextlib
import json
import os
import pathlib
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table

from jaxtrack.cli import common

if TYPE_CHECKING:
    import xarray

    from jaxtrack.study.sweep import Plan

# More expected targets than this lost in a scan, and the user is told.
NEGLIGIBLE = 0.01
WIDTH = 200  # of the table; a number cut short is worse than a line too long


def compare(
    scenario: Annotated[str, typer.Argument(help="See `jaxtrack scenarios`.")],
    trackers: Annotated[
        str | None, typer.Option(help="Names, with commas between; else all.")
    ] = None,
    runs: Annotated[
        int, typer.Option(parser=common.whole, metavar="R", help="Simulated runs.")
    ] = 100,
    seed: Annotated[
        int, typer.Option(parser=common.whole, metavar="S", help="Of the random data.")
    ] = 0,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="NAME=VALUE,VALUE,...; may be repeated."),
    ] = None,
    precision: Annotated[
        int, typer.Option(parser=common.whole, metavar="32|64", help="Bits of a float.")
    ] = 64,
    out: Annotated[pathlib.Path, typer.Option(help="Where the results go.")] = (
        pathlib.Path("out")
    ),
) -> None:
    """Run trackers over many simulated runs, and score them against the truth.

    Writes summary.json, result.nc and pictures. Stopped, it can go on: run it again.
    """
    with common.bad_input(ValueError):
        swept = parse_settings(settings or [])
    common.need("xarray", "h5netcdf", "matplotlib")
    common.start_jax(precision)
    from jaxtrack import engine, scenarios
    from jaxtrack.study import parts, sweep, table

    with common.bad_input(ValueError):
        names = common.names(trackers) if trackers is not None else []
        if trackers is None:
            names = list(scenarios.make(scenario).trackers)
        plan = sweep.plan(scenario, names, runs, seed, swept)
    common.writable(out)
    with common.bad_input(parts.ForeignPart), progress_bar(plan) as progress:
        data = engine.monte_carlo(
            scenario, names, runs, seed, swept, directory=out, progress=progress
        )
    summary = table.summary(data)
    pictures = write(out, plan, data, summary)
    Console(width=WIDTH).print(as_table(scenario, summary))
    warn(scenario, summary)
    warn_limits(plan)
    shown = ", ".join(path.name for path in pictures)
    typer.echo(f"Wrote summary.json, result.nc, {shown} in {out}.")
    parts.discard(out, plan)


def parse_settings(texts: Sequence[str]) -> dict[str, list[float]]:
    """Reads NAME=VALUE,VALUE,...

    Raises:
        ValueError: A text has another form.
    """
    settings: dict[str, list[float]] = {}
    for text in texts:
        name, equals, values = text.partition("=")
        name = name.strip()
        if not (name and equals and values.strip()):
            raise ValueError(f"--set {text!r} is not NAME=VALUE,VALUE,...; write it so")
        if name in settings:
            raise ValueError(f"--set names {name} twice; give its values in one --set")
        settings[name] = [_number(name, value) for value in values.split(",")]
    return settings


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(
            f"{name} has the value {text!r}; give numbers with commas between"
        ) from None


@contextlib.contextmanager
def progress_bar(plan: "Plan") -> Iterator[Callable[[int, int], None]]:
    """Shows on stderr which tracker runs, and how many runs are done of how many."""
    each = plan.runs * len(plan.jobs) // len(plan.trackers)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("runs"),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True)
    quiet = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=quiet) as bar:
        task = bar.add_task("", total=None)

        def progress(done: int, total: int) -> None:
            now = plan.trackers[min(done // each, len(plan.trackers) - 1)]
            bar.update(task, completed=done, total=total, description=now)

        yield progress


def write(
    out: pathlib.Path, plan: "Plan", data: "xarray.Dataset", summary: dict[str, Any]
) -> list[pathlib.Path]:
    """Writes the results, and returns where the pictures are."""
    from jaxtrack import plot
    from jaxtrack.study import numbers, parts

    text = json.dumps(summary, indent=2, allow_nan=False)
    (out / "summary.json").write_text(text + "\n")
    # A killed command leaves no half a file under this name.
    data.to_netcdf(out / "result.nc.part", engine="h5netcdf")
    os.replace(out / "result.nc.part", out / "result.nc")

    figures = {
        "ospa": plot.over_time(data, "ospa"),
        "cardinality": plot.over_time(data, "num_reported"),
        "numbers": numbers.numbers_chart(data),
    }
    for job in plan.jobs:
        if job.point == plan.jobs[0].point:
            seen, world = parts.read_example(out, job), job.values[1]
            place = (world.truth, seen, seen, world.motion, world.sensor)
            title = job.name + "".join(f", {x}={job.point[x]:g}" for x in job.point)
            figures[f"tracks-{job.name}"] = plot.tracks(*place, title=title)
    paths = [out / f"{name}.png" for name in figures]
    for path, figure in zip(paths, figures.values(), strict=True):
        figure.savefig(path, dpi=150)
    return paths


def as_table(scenario: str, summary: dict[str, Any]) -> Table:
    """Lays the rows of a summary out for people, beside what the paper printed."""
    from jaxtrack.study import sweep

    rows = summary["rows"]
    several = len({row["tracker"] for row in rows}) > 1
    title = f"{summary['scenario']}, {summary['runs']} runs, seed {summary['seed']}"
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE)
    table.add_column("tracker", no_wrap=True)
    heads = ["OSPA\n(m)", "paper", "GOSPA\n(m)", "number\nbias", "expected\nbias"]
    heads += ["dropped", "runs/s", "compile\n(s)"]
    for head in [*(x.replace("_", "\n") for x in rows[0]["setting"]), *heads]:
        table.add_column(head, justify="right", no_wrap=True)
    for before, row in zip([None, *rows], rows, strict=False):
        paper = sweep.published(scenario, row["setting"], row["tracker"])
        if before and before["setting"] != row["setting"] and several:
            table.add_section()
        table.add_row(
            row["tracker"],
            *(f"{value:g}" for value in row["setting"].values()),
            _with_error(row["ospa"]),
            "" if paper is None else f"{paper:.1f}",
            _with_error(row["gospa"]),
            _text(row["cardinality_bias"], "+.2f"),
            _text(row["expected_cardinality_bias"], "+.2f"),
            _text(row["dropped"], ".1g"),
            f"{row['runs_per_second']:.3g}",
            f"{row['compile_seconds']:.1f}",
        )
    return table


def _with_error(value: dict[str, float | None]) -> str:
    mean, error = _text(value["mean"], ".2f"), value["stderr"]
    return mean if error is None else f"{mean} ± {error:.2f}"


def _text(value: float | None, form: str) -> str:
    return "not finite" if value is None else format(value, form)


def warn(scenario: str, summary: dict[str, Any]) -> None:
    """Says for which trackers the capacities were too small, and which to raise."""
    from jaxtrack.study import sweep

    capacities = [x for x in sweep.parameters(scenario) if x.startswith("max_")]
    remedy = " or ".join(capacities) or "its capacities"
    worst: dict[str, float] = {}
    for row in summary["rows"]:
        dropped = row["dropped"] or 0.0
        worst[row["tracker"]] = max(dropped, worst.get(row["tracker"], 0.0))
    for tracker, dropped in worst.items():
        if dropped > NEGLIGIBLE:
            common.say(
                f"Warning: {tracker} dropped {dropped:.2g} expected targets a scan, or "
                f"parts of their mixtures, for want of room; raise {remedy} with --set."
            )


def warn_limits(plan: "Plan") -> None:
    """Says which CBMeMBer filters are asked for more than they bear, once for each.

    A target is taken to be expected as well as it is measured.
    """
    import jax

    from jaxtrack.entries import dense
    from jaxtrack.trackers import limits

    said: set[str] = set()
    for job in plan.jobs:
        world: Any = job.values[1]
        sensor: Any = world.sensor
        plain = hasattr(sensor, "cov") and not hasattr(sensor, "at")
        exact = "cbmember" not in job.name or job.name.endswith("-claims")
        if not plain or exact or job.name in said:
            continue
        states = world.truth.state[world.truth.exists]
        where, how_fast = (
            states[:, list(index)]
            for index in (world.motion.position_index, world.motion.velocity_index)
        )
        expected = jax.vmap(sensor.measure)(where, how_fast)
        density = jax.numpy.exp(jax.vmap(world.clutter.log_density)(expected)).max()
        best = jax.vmap(lambda x, w=world: w.detect.prob(0, x, 0.0))(states).max()
        false = limits.false_in_gate(density, 2 * dense(sensor.cov()))
        message = limits.warning(job.name, float(best), false)
        if message is not None:
            said.add(job.name)
            common.say(f"Warning: {message}.")
