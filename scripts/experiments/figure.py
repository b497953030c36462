"""Creating and writing matplotlib figures; matplotlib is optional and imported only when a figure is made."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.io.output import write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS: Final = 64
_STABLE: Final[dict[str, dict[str, Any]]] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches.

    Raises
    ------
    DvrkCmaesError
        matplotlib is not installed.
    """
    os.environ.setdefault("MPLBACKEND", "Agg")
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise DvrkCmaesError("pictures need matplotlib: pip install '.[plots]'") from None
    return Figure(figsize=(width, height), layout="constrained")


def write_figure(path: str | Path, figure: Figure, dots_per_inch: int = 110) -> None:
    """Write a figure in the format of the file name's suffix; errors as in ``dvrk_cmaes.io.output.write_bytes``.

    A PNG has a palette, with which it takes a third of its size.
    """
    suffix = Path(path).suffix.lower()
    buffer = io.BytesIO()
    figure.savefig(buffer, format=suffix[1:], dpi=dots_per_inch, metadata=_STABLE.get(suffix))
    write_bytes(path, _with_palette(buffer.getvalue()) if suffix == ".png" else buffer.getvalue())


def _with_palette(picture: bytes) -> bytes:
    """Return a PNG with at most 64 colours and without transparency."""
    from PIL import Image

    buffer = io.BytesIO()
    with Image.open(io.BytesIO(picture)) as opened:
        opened.convert("RGB").quantize(_COLOURS).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()
