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
    try:
        return importlib.import_module("pandas")
    except ModuleNotFoundError as error:
        raise DataError(
            'Reading and writing tables needs pandas: pip install "jaxtrack[io]".'
        ) from error
