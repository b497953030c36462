"""Motion of a steered endoscope in a synthetic recording, and the readings of the arm that holds it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dvrk_cmaes.geometry import Float64, exp_rotation, inverse, log_rotation, rotation_about_z, transform
from dvrk_cmaes.instrument.endoscope import STRAIGHT, ecm_from_tip_and_jacobian
from dvrk_cmaes.io.encode import rounded_array, rounded_values
from dvrk_cmaes.joints.names import ECM_JOINTS

MOVES: Final = 3
_TILTS: Final = np.deg2rad([0.0, 30.0, -30.0])  # of the camera: a straight endoscope, and one that looks up or down
_TURN, _TILT = np.deg2rad([4.0, 1.0])  # std of the camera in the tip: a turn about the axis, and any other
_ACROSS, _ALONG = 0.002, 0.004  # m, across and along the axis
_START: Final = ((-0.3, 0.3), (-0.3, 0.3), (0.08, 0.18), (-0.5, 0.5))  # range of the joints at first, rad and m
_STEPS: Final = np.array([0.2, 0.2, 0.025, 0.4])  # most by which a joint is moved at once
_AWAY, _TURNED = (0.005, 0.030), np.deg2rad([5.0, 25.0])  # m and rad, range of a move of the camera
_MOVING: Final = (20, 0.1)  # frames that a move takes, and the largest share of the recording
_OFFSET: Final = np.array([*np.deg2rad([2.0, 2.0]), 0.002, np.deg2rad(2.0)])
_ERROR: Final = np.array([*np.deg2rad([0.3, 0.3]), 0.0005, np.deg2rad(0.3)])
_NOISE: Final = np.array([1e-4, 1e-4, 2e-5, 1e-4])  # from reading to reading
_STREAM: Final = 11


@dataclass(frozen=True, eq=False)
class Steering:
    """A steered endoscope in N frames.

    ``joints`` (N, 4) are the true joints of its arm, rad and m, ``errors`` (N, 4) those of their readings, without the
    noise from reading to reading, ``noise`` (N, 4), and the ``offsets`` (4,): true = reading + offset - errors - noise.
    ``tip_from_camera`` (4, 4), m, is the camera in the endoscope's tip.
    """

    joints: Float64
    errors: Float64
    noise: Float64
    offsets: Float64
    tip_from_camera: Float64

    @classmethod
    def draw(cls, seed: int, frames: int) -> Steering:
        """Draw three moves, between which the endoscope stands still; all arms of a seed have the same."""
        rng = np.random.default_rng([seed, _STREAM])
        turned = rotation_about_z(_TURN * rng.standard_normal()) @ exp_rotation([rng.choice(_TILTS), 0.0, 0.0])
        tilted = turned @ exp_rotation(_TILT * rng.standard_normal(3))
        place = np.append(_ACROSS * rng.standard_normal(2), _ALONG * rng.standard_normal())
        tip_from_camera = STRAIGHT @ transform(tilted, place)
        stands = [np.array([rng.uniform(*pair) for pair in _START])]
        while len(stands) <= MOVES:
            offered = stands[-1] + _STEPS * rng.uniform(-1, 1, 4)
            away, angle = _apart(stands[-1], offered, tip_from_camera)
            low, high = np.array(_START).T
            inside = ((offered >= low - _STEPS) & (offered <= high + _STEPS)).all()
            if inside and _AWAY[0] <= away <= _AWAY[1] and _TURNED[0] <= angle <= _TURNED[1]:
                stands.append(offered)
        share = _progress(frames)
        errors = _ERROR * rng.standard_normal((MOVES + 1, 4))
        noise = _NOISE * rng.standard_normal((frames, 4))
        return cls(share @ np.array(stands), share @ errors, noise, _OFFSET * rng.standard_normal(4), tip_from_camera)

    @property
    def camera_from_ecm(self) -> Float64:
        """Pose (N, 4, 4) of the ECM's base in the camera, m."""
        return inverse(ecm_from_tip_and_jacobian(self.joints)[0] @ self.tip_from_camera)

    @property
    def camera_from_first(self) -> Float64:
        """Pose (N, 4, 4) of the first frame's camera in that of each frame, m."""
        ecm = self.camera_from_ecm
        return np.asarray(ecm @ inverse(ecm[0]))

    def late(self, lag: float) -> dict[str, Float64]:
        """Return the readings (N,) by joint, of images that are late by a lag, in frames."""
        count = len(self.joints)
        read = self.joints + self.errors - self.offsets
        at = np.arange(count) + lag
        columns = [np.interp(at, np.arange(count), column) for column in read.T]
        return {name: column + own for name, column, own in zip(ECM_JOINTS, columns, self.noise.T, strict=True)}

    def describe(self, camera_from_base: Float64) -> dict[str, Any]:
        """Return the truth as plain values for JSON, given ``camera_from_base`` (4, 4), m, of the first frame."""
        return {
            "tip_from_camera": rounded_array(self.tip_from_camera),
            "ecm_from_base": rounded_array(inverse(self.camera_from_ecm[0]) @ camera_from_base),
            "offsets": rounded_values(dict(zip(ECM_JOINTS, self.offsets, strict=True))),
        }


def _apart(first: Float64, second: Float64, tip_from_camera: Float64) -> tuple[float, float]:
    """Return the distance, m, and the angle, rad, between the camera's poses at two sets of joints (4,)."""
    poses = ecm_from_tip_and_jacobian(np.stack([first, second]))[0] @ tip_from_camera
    relative = inverse(poses[0]) @ poses[1]
    return float(np.linalg.norm(relative[:3, 3])), float(np.linalg.norm(log_rotation(relative[:3, :3])))


def _progress(frames: int) -> Float64:
    """Return the shares (N, MOVES + 1) of the places at which the endoscope stands, in each frame."""
    at, done = np.arange(frames) / max(frames - 1, 1), np.zeros(frames)
    share = min(_MOVING[0] / frames, _MOVING[1])
    for k in range(MOVES):
        x = np.clip((at - (k + 1) / (MOVES + 1)) / share + 0.5, 0, 1)
        done += x**3 * (10 - 15 * x + 6 * x**2)
    return np.asarray(np.maximum(1 - np.abs(done[:, None] - np.arange(MOVES + 1)), 0.0))
