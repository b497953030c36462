"""Rows of results as a pandas DataFrame, where pandas is installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dvrk_cmaes.errors import InputError


def data_frame(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Return rows with equal columns as a pandas DataFrame.

    Raises
    ------
    InputError
        pandas is not installed.
    """
    try:
        from pandas import DataFrame
    except ImportError:
        raise InputError("to_frame: expected pandas, which is not installed (pip install pandas)") from None
    return DataFrame([dict(row) for row in rows])
