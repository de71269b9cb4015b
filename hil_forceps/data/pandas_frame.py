"""Columns as a pandas DataFrame, where pandas is installed."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_forceps.rig.errors import UserError


def to_pandas(columns: Mapping[str, NDArray[np.float64]]) -> Any:
    """Return a DataFrame with copies of the columns; UserError where pandas can't be imported."""
    try:
        pandas = import_module("pandas")
    except ImportError as error:
        raise UserError(f"to_pandas needs pandas, which can't be imported ({error}); pip install pandas") from error
    return pandas.DataFrame({name: values.copy() for name, values in columns.items()})
