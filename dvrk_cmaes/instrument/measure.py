"""What is measured on the meshes: shaft, jaw tips, mirror symmetry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.instrument.model import Instrument


def measured(
    instrument: Instrument,
    *,
    radius: float | None = None,
    axis: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
) -> Instrument:
    """Fill in what the meshes tell."""
    return instrument
