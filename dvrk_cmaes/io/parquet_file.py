"""Columns of parquet files, read with pyarrow, whose size is checked by the file's metadata beforehand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.errors import InputError, missing_library
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.short_text import listed

_EXPECTED: Final = "a parquet file"
_LARGEST: Final = 500_000_000  # bytes, of the file and of the columns that are read
_MOST_ROWS: Final = 500_000
_MOST_VALUES: Final = 10_000_000


def read_columns(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, list[Any]]:
    """Read columns of a parquet file as plain values, a list of the same length for each column.

    ``names`` must be there; ``optional`` ones are read where they are.

    Raises
    ------
    InputError
        pyarrow is not installed, the file is not readable or too large, or a column is missing.
    """
    with opened(path) as file:
        there = list(file.schema_arrow.names)
        missing = [name for name in names if name not in there]
        if missing:
            raise InputError(f"{path}: expected the fields {listed(missing)}, got {listed(there, 40)}")
        taken = [name for name in dict.fromkeys((*names, *optional)) if name in there]
        _check_size(path, file.metadata, taken)
        columns: dict[str, list[Any]] = file.read(columns=taken).to_pydict()
    return columns


def field_names(path: Path) -> list[str]:
    """Return the names of a parquet file's fields; InputError as `read_columns`."""
    with opened(path) as file:
        return list(file.schema_arrow.names)


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a parquet file; errors of pyarrow, also while it is read, become an InputError."""
    check_file(path, expected=_EXPECTED, largest=_LARGEST)
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise missing_library(f"{path}", "pyarrow") from None
    try:
        with pq.ParquetFile(path) as file:
            yield file
    except (pa.ArrowException, OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: expected {_EXPECTED}, got none ({' '.join(str(error).split())[:100]})") from None


def _check_size(path: Path, metadata: Any, names: Sequence[str]) -> None:
    """Raise an InputError for more rows, values or bytes of some columns than are read."""
    if metadata.num_rows > _MOST_ROWS:
        raise InputError(f"{path}: expected at most {_MOST_ROWS} rows, got {metadata.num_rows}")
    parts = [
        part
        for group in range(metadata.num_row_groups)
        for k in range(metadata.num_columns)
        if (part := metadata.row_group(group).column(k)).path_in_schema.startswith(tuple(names))
    ]
    values, size = sum(part.num_values for part in parts), sum(part.total_uncompressed_size for part in parts)
    if values > _MOST_VALUES or size > _LARGEST:
        raise InputError(
            f"{path}: expected at most {_MOST_VALUES} values and {_LARGEST // 10**6} MB, got {values} and {size} bytes"
        )
