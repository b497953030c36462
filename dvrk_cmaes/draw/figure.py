"""Creating and writing matplotlib figures; matplotlib is optional and imported only when a figure is made."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.output import write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS: Final = (".png", ".pdf", ".svg", ".jpg")

_STABLE: Final[dict[str, dict[str, Any]]] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def check_figure_path(path: Path) -> None:
    """Raise InputError if a figure's file name does not end in one of ``FORMATS``."""
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: expected a picture's name to end in {', '.join(FORMATS)}, got {path.suffix!r}")


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

    A PNG has no alpha channel, which would take a sixth of its size.
    """
    suffix = Path(path).suffix.lower()
    buffer = io.BytesIO()
    figure.savefig(buffer, format=suffix[1:], dpi=dots_per_inch, metadata=_STABLE.get(suffix))
    write_bytes(path, _without_alpha(buffer.getvalue()) if suffix == ".png" else buffer.getvalue())


def _without_alpha(picture: bytes) -> bytes:
    """Return a PNG without its alpha channel."""
    pixels = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    return cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
