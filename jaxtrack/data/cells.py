r"""Cells of a table: read as text, made numbers and times, refused in one sentence.

Example:
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "a.csv"
    >>> _ = path.write_text("time,x\n2020-01-01T00:00:01,4\n2020-01-01T00:00:03,5\n")
    >>> cells = read_cells(path)
    >>> read_times(path, cells["time"])
    (array([0., 2.]), '2020-01-01T00:00:01')
    >>> read_numbers(path, cells["x"])
    array([4., 5.])
"""

import os
import warnings
from typing import Any

import numpy as np

from jaxtrack.data import clock
from jaxtrack.data.errors import DataError, import_pandas

Path = str | os.PathLike[str]


def read_cells(path: Path, max_columns: int | None = None) -> Any:
    """Reads every cell of a CSV file as text, without rows that are blank.

    Args:
        path: The file.
        max_columns: How many columns there may be in a file whose first row does not
            name them; they are then 0, 1, ... up to the last that is used.

    Returns:
        A pandas DataFrame; the index is the row's number in a spreadsheet, where the
        first row of the file is 1. It is empty if the file is.

    Raises:
        DataError: If the file cannot be read, or is no such table.
    """
    frame = _parse(path, max_columns)
    first = 2 if max_columns is None else 1
    frame.index = range(first, len(frame) + first)
    frame = frame.fillna("")
    used = frame != ""
    frame = frame[used.any(axis=1)]
    if max_columns is None:
        frame.columns = [str(name).strip() for name in frame]
        return frame
    return frame.loc[:, used.any()[::-1].cummax()[::-1]]


def write_cells(path: Path, frame: Any, header: bool = True) -> None:
    """Writes a table as CSV, with as many digits as give its numbers back.

    Args:
        path: The file; what it held is lost.
        frame: A pandas DataFrame.
        header: Whether the first row names the columns.

    Raises:
        DataError: If the file cannot be written.
    """
    try:
        frame.to_csv(path, index=False, header=header)
    except OSError as error:
        why = error.strerror or str(error)
        raise DataError(f"{path} cannot be written ({why}); check the path.") from error


def read_times(
    path: Path, cells: Any, start: str | None = None
) -> tuple[np.ndarray, str | None]:
    """Reads seconds, or ISO times as seconds after a start.

    Args:
        path: What to call the table in messages.
        cells: A column of texts [n].
        start: ISO time (UTC) of second 0, by default the earliest.

    Returns:
        Seconds [n], and the start in ISO form, None if the cells are seconds.

    Raises:
        DataError: If a cell is neither.
    """
    pandas = import_pandas()
    if pandas.to_numeric(cells.iloc[:1], errors="coerce").notna().all():
        return read_numbers(path, cells), None
    stamps = pandas.to_datetime(
        cells.str.strip(), format="ISO8601", errors="coerce", utc=True
    )
    why = "is neither seconds nor an ISO time such as 2020-06-30T12:00:00; correct it"
    refuse(path, cells, stamps.isna().to_numpy(), why)
    return clock.seconds_after(stamps.dt.tz_localize(None).to_numpy(), start)


def read_numbers(path: Path, cells: Any) -> np.ndarray:
    """Reads a column of texts [n] that are finite numbers, see `refuse`."""
    pandas = import_pandas()
    values = pandas.to_numeric(cells.str.strip(), errors="coerce").to_numpy(float)
    why = "is not a finite number; correct the cell or remove the row"
    refuse(path, cells, ~np.isfinite(values), why)
    return values


def refuse(path: Path, cells: Any, bad: np.ndarray, why: str) -> None:
    """Raises for the first bad cell of a column, if there is one.

    Args:
        path: What to call the table.
        cells: A column [n], whose index tells the numbers of the rows.
        bad: Which are bad, [n] (bool).
        why: What is wrong with such a cell, and the remedy.

    Raises:
        DataError: Naming table, column, row and cell.
    """
    if bad.any():
        k = int(np.argmax(bad))
        cell = str(cells.iloc[k]).strip()
        raise DataError(
            f"{path}, column {cells.name!r}, row {cells.index[k]}: "
            f"{repr(cell) if cell else 'a blank cell'} {why}."
        )


def _parse(path: Path, max_columns: int | None) -> Any:
    """Reads a CSV file as it is, see `read_cells`."""
    pandas = import_pandas()
    # With names, as a first row that is blank would end the columns.
    given = {} if max_columns is None else {"names": range(max_columns)}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pandas.errors.ParserWarning)
            return pandas.read_csv(
                path,
                **given,
                dtype=str,
                keep_default_na=False,
                skip_blank_lines=False,  # or rows would lose their numbers
                skipinitialspace=True,
                index_col=False,
                encoding="utf-8-sig",
            )
    except FileNotFoundError as error:
        raise DataError(f"{path} does not exist; check the file's path.") from error
    except OSError as error:
        why = error.strerror or str(error)
        raise DataError(f"{path} cannot be read ({why}); check the path.") from error
    except pandas.errors.EmptyDataError:
        return pandas.DataFrame()
    except (ValueError, pandas.errors.ParserWarning) as error:
        why = str(error).strip().split("C error: ")[-1]
        if isinstance(error, pandas.errors.ParserWarning):
            most = "the header" if max_columns is None else str(max_columns)
            why = f"a row has more cells than {most}"
        raise DataError(
            f"{path} is not a table in CSV form ({why}); separate its columns by "
            "commas and save it as UTF-8 text."
        ) from error
