"""The page's view of the scene in space: camera, arm's base, and each frame's shaft and tips, which a script draws."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.report.page_session import FrameBases
from dvrk_cmaes.results.result import Result

_SHAFT = 0.08  # m, length of the shaft that is drawn where the arm's base is not known
_AXIS = 0.02  # m, length of the base's axes


def scene_of(results: Sequence[Result], base: FrameBases | None) -> str | None:
    """Return the scene as JSON, None without a pose.

    ``frames`` are lists of the frame's index, its status, the shaft's far end, the root's origin and the tips;
    ``base`` are the ends of the base's axes and its origin, null if it is not known. Points are (x, y, z) in the
    camera, mm. The shaft is drawn from the arm's remote centre of motion on.
    """
    frames = []
    for place, result in enumerate(results):
        pose = result.camera_from_root
        if pose is None:
            continue
        origin, along = pose[:3, 3], pose[:3, 2]
        length = _SHAFT if base is None else max(float((origin - base.centre) @ along), _SHAFT)
        points = [origin - length * along, origin, *result.tips]
        frames.append([place, result.status, *(_millimetres(point) for point in points)])
    if not frames:
        return None
    axes = None
    known = [result.camera_from_base for result in results if result.camera_from_base is not None]
    if base is not None and known:
        middle = min(known, key=lambda base_of_frame: float(np.linalg.norm(base_of_frame[:3, 3] - base.centre)))
        axes = [_millimetres(base.centre + _AXIS * axis) for axis in middle[:3, :3].T] + [_millimetres(base.centre)]
    return json.dumps({"frames": frames, "base": axes}, separators=(",", ":"))


def _millimetres(point: Float64) -> list[float]:
    return [round(value, 1) for value in (1e3 * point).tolist()]
