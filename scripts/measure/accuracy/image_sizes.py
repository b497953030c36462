"""Images of many sizes: whether every drawn mask has a result, and tips against the same scenes at 640 x 480.

The masks are drawn silhouettes of the instrument, with the joints and readings of a session's frames. In the first
table the tool is at random places of the image and so far away that it covers 0.1 to 60 % of it. In the second one it
is where it is in the session, and the camera has more pixels for the same field of view, or for a wider one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.truth import FrameTruth
from dvrk_cmaes.geometry import exp_rotation, transform
from dvrk_cmaes.silhouette import Renderer
from dvrk_cmaes.silhouette.prepare import decimated_body
from measure.accuracy.errors import compared
from measure.accuracy.figures import percentiles
from measure.cases import Case, Measurement

SIZES: Final = (
    *((720, 480), (1300, 1024), (1280, 1024), (1400, 986), (740, 540), (1264, 1008), (1000, 800), (1920, 1080)),
    *((640, 480), (720, 576), (960, 540), (1280, 720), (3840, 2160), (160, 120)),
)
COMPARED: Final = ((640, 480), (1280, 1024), (1920, 1080))
TOOLS: Final = 100  # of each size
_SHARES = np.log([0.001, 0.6])  # of the image that the tool covers
_DISTANCES = np.log([0.008, 1.5])  # m
_SMALL, _DETAIL = 80, 2e-3  # width, px, of the images in which the distance is found; cells of their mesh, m
_HALVINGS = 12
_CLOSE = 0.2  # of the logarithm of the share


def image_sizes_report(given: Measurement) -> dict[str, list[dict[str, Any]]]:
    """Return the results of drawn masks by size of the image, and the errors of the same scenes at some sizes.

    ``given.frames`` is the number of masks of each size, and of scenes; 100 and all by default.
    """
    cases = replace(given, frames=None).cases()
    return {
        "drawn masks": [_results(given, cases, size) for size in SIZES],
        "the same scenes": list(_scenes(given, cases[: given.frames])),
    }


def camera_of(case: Case, size: tuple[int, int]) -> Camera:
    """Return the camera of a case with another size of its images, which show at least the same field of view."""
    camera, (width, height) = case.camera, size
    scale = min(width / camera.width, height / camera.height)
    cx = (camera.cx + 0.5 - camera.width / 2) * scale + width / 2 - 0.5
    cy = (camera.cy + 0.5 - camera.height / 2) * scale + height / 2 - 0.5
    return Camera(width, height, camera.fx * scale, camera.fy * scale, cx, cy, camera.distortion, camera.model)


def drawn(given: Measurement, case: Case, camera: Camera, pose: NDArray[np.float64], kind: str) -> Case:
    """Return a case with the drawn mask of its instrument at another pose (4, 4) in another camera."""
    assert case.truth is not None
    joints = case.true(given.instrument).joints
    mask = Renderer(given.body, camera, threads=1).masks(pose[None], joints[None])[0]
    truth = FrameTruth(pose, case.truth.joints)
    return replace(case, data=FrameData.of(mask, camera), truth=truth, kind=kind)


def placed(given: Measurement, case: Case, camera: Camera, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a pose (4, 4), turned about the optical axis, at which the tool covers 0.1 to 60 % of an image."""
    at, share = case.true(given.instrument), rng.uniform(*_SHARES)
    small = camera.scaled(_SMALL, max(round(_SMALL * camera.height / camera.width), 1))
    renderer = Renderer(decimated_body(given.body, _DETAIL), small, threads=1)
    while True:
        rotation = exp_rotation(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])) @ at.pose[:3, :3]
        pixel = rng.uniform(-0.1, 1.1, 2) * [camera.width, camera.height]
        ray = np.array([*camera.normalise(pixel), 1.0])
        near, far = _DISTANCES
        for _ in range(_HALVINGS):
            middle = (near + far) / 2
            pose = transform(rotation, ray * np.exp(middle))
            covered = np.log(max(float(renderer.coverage(pose[None], at.joints[None])[0].mean()), 1e-9))
            near, far = (middle, far) if covered > share else (near, middle)
        if abs(covered - share) < _CLOSE:
            return pose


def _results(given: Measurement, cases: Sequence[Case], size: tuple[int, int]) -> dict[str, Any]:
    """Return a row of the results of drawn masks of a size."""
    kind, tools = f"{size[0]} x {size[1]}", []
    for number in range(given.frames or TOOLS):
        case = cases[number % len(cases)]
        camera, rng = camera_of(case, size), np.random.default_rng([*size, number])
        tool = drawn(given, case, camera, placed(given, case, camera, rng), kind)
        tools.append(replace(tool, frame=f"{number:04d}"))
    runs = given.runs(tools, kind)
    return {
        "size": kind,
        "masks": len(runs),
        "share": percentiles([float(case.mask.mean()) for case in tools], (0, 50, 100)),
        "errors": sum(run.failed for run in runs),
        "ok": sum(run.trusted for run in runs),
        "cpu_s": percentiles([run.cpu_seconds for run in runs], (50,))[0],
        "first_error": next((run.result.reasons[0] for run in runs if run.failed), None),
    }


def _scenes(given: Measurement, cases: Sequence[Case]) -> Iterator[dict[str, Any]]:
    """Yield a row of the errors of the same scenes for each size."""
    for size in COMPARED:
        kind = f"scene at {size[0]} x {size[1]}"
        tools = [drawn(given, case, camera_of(case, size), case.true(given.instrument).pose, kind) for case in cases]
        found = list(compared(given.instrument, given.runs(tools, kind)))
        yield {
            "size": f"{size[0]} x {size[1]}",
            "scenes": len(found),
            "right_mode": sum(one.right_mode for one in found),
            "ok": sum(one.run.trusted for one in found),
            "tip_mm": percentiles([one.tip_mm for one in found]),
            "result_s": percentiles([one.run.result.seconds for one in found], (50,))[0],
            "cpu_s": percentiles([one.run.cpu_seconds for one in found], (50,))[0],
        }
