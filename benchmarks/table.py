"""Writes the results into README.md, between two marks.

>>> from benchmarks import table
>>> table.number(12345.0), table.number(0.1234)
('12,300', '0.123')
"""

import itertools
import json
import math
import pathlib
from collections.abc import Sequence
from typing import Any

HERE = pathlib.Path(__file__).parent
LATEST = HERE / "results" / "latest.json"
README = HERE.parent / "README.md"
BEGIN, END = "<!-- benchmarks -->\n", "<!-- end of benchmarks -->\n"
Row = dict[str, Any]  # of the results
LONG = "growth", "multiscan"  # not shown
UNITS = {"G": 1e9, "M": 1e6, "k": 1e3}


def number(value: float) -> str:
    """Returns a number with three digits that count."""
    if value == 0 or not math.isfinite(value):
        return str(value)
    digits = 2 - math.floor(math.log10(abs(value)))
    return f"{round(value, digits):,.{max(digits, 0)}f}"


def rate(value: float, unit: str) -> str:
    """Returns a rate with its unit, thousands and millions as letters."""
    for letter, size in UNITS.items():
        if unit.endswith("/s") and value >= size:
            return f"{number(value / size)} {letter} {unit}"
    return f"{number(value)} {unit}"


def line(rows: Sequence[Row]) -> str:
    """Returns one line of the table, of rows that differ in their peers only."""
    row, pairs = rows[0], [(x["peer"], x["ratio_to_peer"]) for x in rows]
    beside = ", ".join(f"{number(ratio)} x {peer}" for peer, ratio in pairs if peer)
    limit = number(row["ratio_to_limit"]) if row["limit"] else ""
    bits = row["precision"].removeprefix("float")
    cells = row["work"], bits, rate(row["rate"], row["unit"]), beside, limit
    return f"| {' | '.join(cells)} |"


def same(row: Row) -> tuple[str, ...]:
    """Returns what is equal in rows that differ in their peers only."""
    return row["work"], row["precision"], row["unit"]


def table(results: dict[str, Any]) -> str:
    """Returns all rows as a table in Markdown, and what they were made with."""
    made = results["made_with"]
    versions = ", ".join(f"{name} {x}" for name, x in made["versions"].items())
    head = ["| work | bits | rate | beside | share of C |", "|---|---|---|---|---|"]
    shown = [row for row in results["rows"] if row["benchmark"] not in LONG]
    lines = [line(list(rows)) for _, rows in itertools.groupby(shown, same)]
    text = "\n".join([*head, *lines])
    return f"{text}\n\nMade on {made['cpu']}, with {versions}.\n"


def paste() -> None:
    """Puts the table of the latest results into README.md.

    Raises:
        ValueError: README.md has no place for it.
    """
    text = README.read_text()
    if BEGIN not in text or END not in text:
        raise ValueError(f"{README} lacks the lines {BEGIN.strip()} and {END.strip()}")
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    results = json.loads(LATEST.read_text())
    README.write_text(before + BEGIN + table(results) + END + after)


if __name__ == "__main__":
    paste()
