"""The command `jaxtrack track`: tracks, a picture and scores from recorded detections.

>>> from jaxtrack.cli import track
>>> track.sentence({"idf1": 0.5, "num_switches": 3, "gospa": {"mean": 12.34}})
'IDF1 0.500, 3 identity switches, GOSPA 12.3 m on average.'
"""

import contextlib
import importlib
import json
import math
import pathlib
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from jaxtrack.cli import common

if TYPE_CHECKING:
    from jaxtrack.data.files import Table
    from jaxtrack.recorded.settings import Settings
    from jaxtrack.recorded.tracking import Result

# More expected targets than this lost in a scan, and the user is told.
NEGLIGIBLE = 0.01


def track(
    file: Annotated[
        pathlib.Path | None,
        typer.Argument(help="CSV with columns time, and x, y (m) or lat, lon (deg)."),
    ] = None,
    config: Annotated[
        pathlib.Path | None,
        typer.Option(help="Settings, see `jaxtrack config`.  [default: from the data]"),
    ] = None,
    truth_column: Annotated[
        str | None, typer.Option(help="Identities, to score against; never tracked.")
    ] = None,
    tracker: Annotated[
        str | None,
        typer.Option(help="Its name, such as gnn or jipda; see `jaxtrack config`."),
    ] = None,
    harbour: Annotated[
        bool, typer.Option("--harbour", help="Track the ships of New York harbour.")
    ] = False,
    precision: Annotated[int, typer.Option(help="Bits of a float, 32 or 64.")] = 64,
    out: Annotated[pathlib.Path, typer.Option(help="Where the results go.")] = (
        pathlib.Path("out")
    ),
) -> None:
    """Track recorded detections.

    Writes tracks.csv, tracks.png and summary.json; where the tracker tells afterwards
    where targets have been, smoothed.csv, which is what is drawn then.
    """
    if (file is None) != harbour:
        common.fail("give either a FILE, or --harbour for the file that ships with it")
    common.need("pandas", "matplotlib", "scipy")
    common.start_jax(precision)
    from jaxtrack.data import files
    from jaxtrack.recorded import reading, scoring, settings, tracking

    with common.bad_input(ValueError), warned():
        if harbour:
            file, truth_column = files.harbour_path(), truth_column or "MMSI"
        chosen = reading.harbour() if harbour else settings.Settings()
        if config:
            chosen = reading.load(config)
        if tracker is not None:
            chosen = settings.with_algorithm(chosen, tracker)
        table = read(file, chosen)
        if truth_column is not None:
            files.further_column(table, truth_column)
        common.writable(out)
        result = tracking.track(table, chosen)
        later = tracking.smoothed(result)
        every = {"scores": result, "smoothed_scores": later}
        summary = summarise(file, table, result)
        for name, told in every.items():
            if truth_column is None or told is None:
                continue
            scores = scoring.score(told, table, truth_column)
            part = scoring.summary(scores, result.settings.score)
            summary[name] = {"truth_column": truth_column, **part}
            typer.echo(("" if told is result else "Smoothed: ") + sentence(part))
    names = write(out, table, result, later, summary, truth_column)
    warn(summary)
    warn_limits(table, result.settings)
    typer.echo(f"Wrote {', '.join(names)} in {out}.")


def read(file: Any, settings: "Settings") -> "Table":
    """Reads the detections, with the columns and the order that the settings name."""
    from jaxtrack.data import files

    names = {key: getattr(settings.file, key) for key in files.ALIASES}
    columns = {key: name for key, name in names.items() if name is not None}
    return files.read_detections(file, columns, settings.file.sort)


def summarise(file: Any, table: "Table", result: "Result") -> dict[str, Any]:
    """Collects what summary.json holds but for the scores."""
    from jaxtrack.recorded import settings

    estimates, scans = result.estimates, result.scans
    evidence = float(estimates.log_evidence.sum())
    return {
        "file": pathlib.Path(file).name,
        "version": importlib.import_module("jaxtrack").__version__,
        "detections": len(table.time),
        "scans": len(scans.time),
        "tracks": len(set(estimates.label[estimates.exists].tolist())),
        "reported": int(estimates.exists.sum()),
        "dropped_detections": int(scans.dropped.sum()),
        "dropped": float(estimates.dropped.mean()),
        # JSON has no infinity; None where a scan was impossible to the model.
        "log_evidence": evidence if math.isfinite(evidence) else None,
        "seconds": result.seconds,
        "compile_seconds": result.compile_seconds,
        "settings": settings.as_dict(result.settings),
    }


def write(
    out: pathlib.Path,
    table: "Table",
    result: "Result",
    later: "Result | None",
    summary: dict[str, Any],
    truth_column: str | None,
) -> list[str]:
    """Writes the tracks, the picture and the summary; returns the files' names."""
    from jaxtrack.data import files, tables
    from jaxtrack.recorded import picture

    motion = result.motion
    index = motion.position_index, motion.velocity_index
    place = table.origin, table.start
    every = {"tracks.csv": result} | ({"smoothed.csv": later} if later else {})
    (out / "smoothed.csv").unlink(missing_ok=True)  # of another tracker
    for name, told in every.items():
        tracks = tables.tracks_table(told.scans.time, told.estimates, *index, *place)
        tables.write_tracks(out / name, tracks)
    truth = None
    if truth_column is not None:
        truth = files.further_column(table, truth_column)
    drawn = (later or result).estimates
    number = len(set(drawn.label[drawn.exists].tolist()))
    kind = "tracks, smoothed" if later else "tracks"
    title = f"{summary['file']}: {number} {kind}"
    figure = picture.chart(later or result, table, truth, title)
    figure.savefig(out / "tracks.png", dpi=150)
    text = json.dumps(summary, indent=2, allow_nan=False)
    (out / "summary.json").write_text(text + "\n")
    return [*every, "tracks.png", "summary.json"]


def sentence(scores: dict[str, Any]) -> str:
    """Says how well the tracks fit the truth."""
    gospa = scores["gospa"]["mean"]
    distance = "not scored" if gospa is None else f"{gospa:.1f} m on average"
    return (
        f"IDF1 {scores['idf1']:.3f}, {scores['num_switches']} identity switches, "
        f"GOSPA {distance}."
    )


def warn(summary: dict[str, Any]) -> None:
    """Says what may make the tracks worse than they could be."""
    if summary["dropped"] > NEGLIGIBLE:
        common.say(
            f"Warning: {summary['dropped']:.2g} expected targets a scan were dropped "
            "for want of room; raise max_tracks, max_births or max_parents."
        )
    if not summary["tracks"]:
        common.say(
            "Warning: no track was reported; look at the settings of the sensor and of "
            "the targets in summary.json."
        )
    period = summary["settings"]["scans"]["period"]
    if period is None and summary["detections"] < 1.5 * summary["scans"]:
        common.say(
            "Warning: most scans hold a single detection; if targets report one by "
            "one, set a period in [scans]."
        )


def warn_limits(table: "Table", settings: "Settings") -> None:
    """Says if a CBMeMBer filter is asked for more than it bears.

    Clutter is where detections are, and a target is expected as well as it is measured.
    """
    import jax.numpy as jnp
    import numpy as np

    from jaxtrack.trackers import limits

    if settings.tracker.name != "cbmember":
        return
    variance = (settings.sensor.noise_std or 0.0) ** 2
    sides = np.ptp(table.xy, axis=0) + 20 * variance**0.5
    false = limits.false_in_gate(
        settings.sensor.clutter_rate / sides.prod(), 2 * variance * jnp.eye(2)
    )
    best = max(mode.detect_prob for mode in settings.modes.values())
    message = limits.warning("cbmember", best, false, "use --tracker jipda")
    if message is not None:
        common.say(f"Warning: {message}.")


@contextlib.contextmanager
def warned() -> Iterator[None]:
    """Prints warnings as sentences."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        yield
    for warning in caught:
        common.say("Warning: " + " ".join(str(warning.message).split()))
