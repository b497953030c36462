"""How far each further view of a rig would turn, if the masks alone decided: a check of the rig's calibration.

At the pose that fits all views together, the distances of one view's contour from the outline tell where that view
would rather have the instrument. A small rotation w of the view about the reference camera moves the instrument in
that view only, so w is a further unknown of the normal equations, with the pose eliminated. A wrong baseline looks like
a rotation as well: at the distance z, an error e of the baseline is a rotation by e / z.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import adjoint, inverse
from dvrk_cmaes.pose.refine.correlated_noise import contour_terms, invertible
from dvrk_cmaes.pose.refine.joint_refiner import JointRefiner
from dvrk_cmaes.pose.refine.outline import OutlineFit

Float64 = NDArray[np.float64]

_REACH = 24  # px, in which the contour is searched
_UNKNOWN = np.pi**2  # variance of a rotation, rad^2, where a contour is out of reach


def rig_rotations(
    refiner: JointRefiner, fit: OutlineFit, informations: Sequence[Float64]
) -> list[tuple[Float64, Float64]]:
    """Return the rotation (3,), rad, of each view but the first about the camera's axes, and its covariance (3, 3).

    ``informations`` (6 + J, 6 + J) are those of the views at the pose of ``fit``, weighted by the masks' errors.
    """
    pose, joints = fit.camera_from_root, fit.joints
    found: list[tuple[Float64, Float64]] = []
    terms = [contour_terms(view, seen @ pose, joints, reach=_REACH) for view, seen in refiner.views]
    known = [term for term in terms if term is not None]
    if len(known) < len(terms):
        return [(np.zeros(3), _UNKNOWN * np.eye(3))] * (len(terms) - 1)
    turn = np.zeros((len(informations[0]), 3))
    turn[:6] = adjoint(inverse(pose))[:, 3:]
    own, slopes = [term[0] for term in known], [term[1] for term in known]
    slope = np.sum(slopes, axis=0)
    for k in range(1, len(own)):
        reduced = _reduced(own, k, turn)
        along = turn.T @ (slopes[k] - own[k] @ np.linalg.solve(invertible(np.sum(own, axis=0)), slope))
        covariance = np.linalg.inv(_reduced(informations, k, turn))
        found.append((np.asarray(-np.linalg.solve(reduced, along)), np.asarray(covariance)))
    return found


def _reduced(informations: Sequence[Float64], view: int, turn: Float64) -> Float64:
    """Return the information (3, 3) about the rotation of one view, with the pose eliminated.

    ``turn`` (6 + J, 3) are the small changes of the pose in that view by a rotation of the view.
    """
    one, whole = informations[view], np.sum(informations, axis=0)
    reduced = turn.T @ (one - one @ np.linalg.solve(invertible(whole), one)) @ turn
    return np.asarray(reduced + 1e-6 * np.trace(reduced) * np.eye(3))
