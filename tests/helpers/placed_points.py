"""Points that are fixed on an instrument, placed by its forward kinematics alone."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes import Instrument
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.silhouette.moving_points import FixedPoints


def placed_points(instrument: Instrument, fixed: FixedPoints, at: Posed) -> np.ndarray:
    """Return points (N, 3), m, at one pose, in the frame of the camera that it is in."""
    of_points = (at.pose @ instrument.forward(at.joints))[np.asarray(fixed.link)]
    return np.einsum("nij,nj->ni", of_points[:, :3, :3], fixed.points) + of_points[:, :3, 3]
