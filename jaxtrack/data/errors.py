"""What may go wrong with files, said in one sentence each.

Example:
    >>> from jaxtrack.data.errors import DataError
    >>> issubclass(DataError, ValueError)
    True
"""

import importlib
from typing import Any


class DataError(ValueError):
    """Says in one sentence which file, column or cell is wrong, and the remedy."""


def import_pandas() -> Any:
    """Imports pandas, which only files and tables need, when it is first needed.

    Returns:
        The module.

    Raises:
        DataError: If pandas is not installed.
    """
    return _import("pandas", "Reading and writing tables needs pandas", "io")


def import_xarray() -> Any:
    """Imports xarray, which only labelled arrays need; as `import_pandas`."""
    return _import("xarray", "Labelled arrays need xarray", "io")


def import_stonesoup(part: str) -> Any:
    """Imports a part of Stone Soup such as `types.track`; as `import_pandas`."""
    what = "Exchanging data with Stone Soup needs stonesoup"
    return _import(f"stonesoup.{part}", what, "stonesoup")


def _import(module: str, what: str, extra: str) -> Any:
    """Imports a module, or says what it is needed for and which extra brings it."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise DataError(f'{what}: pip install "jaxtrack[{extra}]".') from error
