"""Runs all benchmarks, each in a process of its own, and keeps their rows.

`python -m benchmarks kalman imm` runs these two anew and leaves the other rows as they
are, if they were made on such a processor with the same versions; each row says of
which commit it is. What is done is kept when a later one fails.
"""

import argparse
import importlib.metadata
import json
import os
import pathlib
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

from benchmarks import climit, table

ALL = (
    *("kalman", "extended", "imm", "gaussians", "gradient", "assign", "multiscan"),
    *("jpda", "phd", "particles", "cores", "start", "study", "growth"),
    "trajectories",
)
PACKAGES = (
    *("jax", "jaxlib", "numpy", "scipy"),
    *("dynamax", "filterpy", "stonesoup", "pyehm", "cuthbert"),
)


def made_with() -> dict[str, Any]:
    """Returns what the results depend on besides the code."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    flags = os.environ.get("XLA_FLAGS", "")
    return {"cpu": climit.cpu_model(), "versions": versions, "xla_flags": flags}


def run(name: str, quick: bool) -> list[dict[str, Any]]:
    """Runs one benchmark and returns its rows."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, "rows.json")
        command = [sys.executable, "-m", f"benchmarks.{name}", "--out", str(path)]
        subprocess.run([*command, *(["--quick"] if quick else [])], check=True)
        made = {"benchmark": name, "commit": commit()}
        return [{**made, **row} for row in json.loads(path.read_text())]


def commit() -> str:
    """Returns the commit that is checked out, with a + where files differ from it."""
    told = subprocess.run(
        ["git", "describe", "--always", "--dirty=+", "--exclude=*"],
        cwd=table.HERE,
        capture_output=True,
        text=True,
        check=False,
    )
    return told.stdout.strip() or "unknown"


def kept(fail: Callable[[str], Any]) -> list[dict[str, Any]]:
    """Returns the rows of the last results; fails where they were made with others."""
    if not table.LATEST.exists():
        fail(f"there is no {table.LATEST} yet; run all benchmarks")
    results = json.loads(table.LATEST.read_text())
    if results["made_with"] != made_with():
        fail(
            f"{table.LATEST} was made on another processor or with other versions; run "
            "all benchmarks"
        )
    return results["rows"]


def main() -> None:
    """Runs all and writes `results/latest.json` and the table in README.md."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="tiny sizes; keep nothing")
    parser.add_argument("names", nargs="*", metavar="name", help="run these only")
    options = parser.parse_args()
    if unknown := set(options.names) - set(ALL):
        parser.error(f"no benchmark is {min(unknown)}; there are {', '.join(ALL)}")
    quick, names = options.quick, options.names or ALL
    rows = [] if quick or not options.names else kept(parser.error)
    for name in names:
        start = time.monotonic()
        print(f"{name} ...", file=sys.stderr, flush=True)
        rows = [row for row in rows if row["benchmark"] != name] + run(name, quick)
        print(f"    {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
        if not quick:
            rows.sort(key=lambda row: ALL.index(row["benchmark"]))
            results = {"made_with": made_with(), "rows": rows}
            table.LATEST.parent.mkdir(exist_ok=True)
            table.LATEST.write_text(json.dumps(results, indent=1) + "\n")
            table.paste()


if __name__ == "__main__":
    main()
