"""Export of the initial state of a tracker: the NumPy files of online_dvrk_tracking, one folder per frame.

``optimized_ctr.npy`` (6,): ``camera_from_root`` as axis times angle (rad), then translation (m).
``optimized_joint_angles.npy`` (4,): wrist pitch, wrist yaw, and the angles of jaw_2 and jaw_1 from the middle plane, so
that the opening ``jaw`` is their sum; rad. Both arrays are float32, as in that program.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.geometry import Float32, Float64, log_rotation
from dvrk_cmaes.results.result import Result

POSE, JOINTS = "optimized_ctr.npy", "optimized_joint_angles.npy"


def tracker_files(results: Sequence[Result]) -> dict[str, bytes]:
    """Return the contents of the files by ``FRAME/NAME``; frames without a pose have no files.

    Raises
    ------
    InputError
        A result has no wrist pitch, wrist yaw or jaw, which the tracker requires.
    """
    files: dict[str, bytes] = {}
    for result in results:
        if result.camera_from_root is not None:
            files[f"{result.frame}/{POSE}"] = _npy(pose_vector(result.camera_from_root))
            files[f"{result.frame}/{JOINTS}"] = _npy(joint_vector(result))
    return files


def pose_vector(camera_from_root: Float64) -> Float32:
    """Convert a pose (4, 4) to axis times angle, rad, and translation, m, (6,)."""
    return np.concatenate([log_rotation(camera_from_root[:3, :3]), camera_from_root[:3, 3]]).astype(np.float32)


def joint_vector(result: Result) -> Float32:
    """Return wrist pitch, wrist yaw, jaw_2 and jaw_1 (4,), rad; InputError as for ``tracker_files``."""
    missing = [name for name in ("wrist_pitch", "wrist_yaw", "jaw") if name not in result.joints]
    if missing:
        raise InputError(f"{result.frame}: joints: expected wrist_pitch, wrist_yaw and jaw, got no {missing[0]}")
    half = result.joints["jaw"] / 2  # the jaws open symmetrically
    return np.array([result.joints["wrist_pitch"], result.joints["wrist_yaw"], half, half], dtype=np.float32)


def _npy(array: Float32) -> bytes:
    """Return an array in the .npy format."""
    data = io.BytesIO()
    np.save(data, array, allow_pickle=False)
    return data.getvalue()


def exported(request: ExportRequest) -> Exported:
    """Export the poses of frames; InputError if there are no frames."""
    return Exported(tracker_files(request.source.poses()), left_out=request.source.without_pose)
