"""Real images without masks: how often a tracker brings a moved pose back to the one that the image's mask yields.

The tracker has the colours of the other images of the session, learned at the poses that their masks yield. It starts
from a pose that is moved by 3 mm, turned by 5 deg, and bent by 10 deg in every joint, in random directions, and is then
shown the image for three steps. From the same poses and colours the image is also fitted as that of a recording on disk
is, by a mask that is found around the silhouette.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.geometry import Posed, moved
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.pose.views import silhouette_of
from dvrk_cmaes.results.parts import posed
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.histogram_ratio import ColourModel
from dvrk_cmaes.track.image_frames import fit_block
from dvrk_cmaes.track.image_masks import learned_colours, pooled_colours
from dvrk_cmaes.track.recorded_frames import PredictedFrame
from measure.cases import Case, Measurement, grouped

Float64 = NDArray[np.float64]

TRIALS: Final = 10  # of an image
STEPS: Final = 3
_MOVED: Final = 3e-3  # m
_TURNED, _BENT = np.deg2rad(5.0), np.deg2rad(10.0)
_BACK_MM, _BACK_DEG = 1.0, 5.0
_ACROSS_MM: Final = 2.0
_INTERVAL: Final = 1 / 30  # s


class _Shown(NamedTuple):
    """An image, as a case, and the result of its mask."""

    case: Case
    result: Result


def perturbed_report(given: Measurement) -> dict[str, list[dict[str, Any]]]:
    """Return a row of figures for each session, of its first images."""
    cases = replace(given, frames=None).cases(truth=False, images=True)
    sessions = grouped(cases, lambda case: case.session)
    rows = [_session_rows(name, own, given) for name, own in sessions.items()]
    return {
        "moved poses, followed by images": [of_tracker for of_tracker, _ in rows],
        "moved poses, fitted as images of a recording": [of_fit for _, of_fit in rows],
    }


def _session_rows(name: str, cases: Sequence[Case], given: Measurement) -> tuple[dict[str, Any], dict[str, Any]]:
    body, config = given.body, given.config
    estimated = [_Shown(case, case.estimate(body, config)) for case in cases if case.data.image is not None]
    shown = [one for one in estimated if one.result.camera_from_root is not None]
    followed, fitted = [], []
    for k, one in enumerate(shown[: given.frames]):
        rng = np.random.default_rng(k)
        others = shown[:k] + shown[k + 1 :]
        starts = [_moved(one.result, rng) for _ in range(TRIALS)]
        followed += [_errors(one, *_followed(one, others, body, config, start)) for start in starts]
        colours = pooled_colours([model for other in others if (model := _colours(other, body)) is not None])
        fitted += [_errors(one, *_fitted(one, colours, body, config, start)) for start in starts]
        print(f"{name}: {k + 1} of {len(shown[: given.frames])} images", file=sys.stderr, flush=True)
    images = len(shown[: given.frames])
    return _row(name, images, followed), _row(name, images, fitted)


def _row(name: str, images: int, errors: Sequence[Sequence[float]]) -> dict[str, Any]:
    table = np.array(errors)
    back = (table[:, 0] < _BACK_MM) & (table[:, 2] < _BACK_DEG)
    across = (table[:, 1] < _ACROSS_MM) & (table[:, 2] < _BACK_DEG)
    medians = np.median(table, axis=0)
    return {
        "session": name,
        "images": images,
        "trials": len(table),
        "back": float(back.mean()),
        "back across the view": float(across.mean()),
        "root, mm": float(medians[0]),
        "across the view, mm": float(medians[1]),
        "axis, deg": float(medians[2]),
        "ok": float(table[:, 3].mean()),
    }


def _followed(
    one: _Shown, others: Sequence[_Shown], body: Body, config: EstimateConfig, start: Result
) -> tuple[Float64, bool]:
    """Follow an image from a moved pose; returns the pose (4, 4), m, and whether it is ok."""
    tracker, time = Tracker(one.case.camera, body, config=config, lag=0.0, evidence="images"), 0.0
    for other in others:
        time += _INTERVAL
        tracker.start(time, other.result, image=other.case.data.image)
    time += 1.0
    tracker.add_readings(time, one.case.readings)
    tracker.start(time, start)
    for _ in range(STEPS):
        time += _INTERVAL
        tracker.add_readings(time, one.case.readings)
        result = tracker.step(time, image=one.case.data.image)
    assert result.camera_from_root is not None
    return result.camera_from_root, result.status == "ok"


def _colours(other: _Shown, body: Body) -> ColourModel | None:
    """Return the colours of an image at the pose that its mask yields."""
    view = other.case.data.views[0]
    assert view.image is not None
    return learned_colours(view.image, silhouette_of(_posed(other.result, body), view, body), view.ignore)


def _fitted(
    one: _Shown, colours: ColourModel, body: Body, config: EstimateConfig, start: Result
) -> tuple[Float64, bool]:
    """Fit an image about a moved pose; returns as `_followed`, not ok where nothing is found or it is not explained."""
    assert start.covariance is not None
    view = replace(one.case.data.views[0], mask=np.zeros_like(one.case.mask), given=False)
    data = FrameData((view,))
    expected = Expected(_posed(start, body), np.asarray(np.linalg.inv(start.covariance), np.float64))
    frame = PredictedFrame(one.case.frame, lambda: data, expected)
    (found,) = fit_block(body, config, [frame], masks=None, colours={view.name: colours})
    if found is None:
        assert start.camera_from_root is not None
        return start.camera_from_root, False
    return found.fit.at.pose, found.fit.explains_mask and not found.doubts


def _posed(result: Result, body: Body) -> Posed:
    """Return a result's pose and joints."""
    assert result.camera_from_root is not None
    return posed(result, body.instrument.joint_names)


def _moved(result: Result, rng: np.random.Generator) -> Result:
    """Return a result with a moved pose, the standard deviations of that motion, and no alternatives."""
    assert result.camera_from_root is not None
    shift, turn = (
        size * v / np.linalg.norm(v) for size, v in ((_MOVED, rng.normal(size=3)), (_TURNED, rng.normal(size=3)))
    )
    bend = _BENT * rng.choice([-1.0, 1.0], len(result.joints))
    sizes = np.concatenate([np.full(3, _MOVED / 3**0.5), np.full(3, _TURNED / 3**0.5), np.full(len(bend), _BENT)])
    return replace(
        result,
        camera_from_root=moved(result.camera_from_root, np.concatenate([shift, turn])),
        joints={name: value + off for (name, value), off in zip(result.joints.items(), bend.tolist(), strict=True)},
        covariance=np.diag(sizes**2),
        alternatives=(),
    )


def _errors(one: _Shown, found: Float64, ok: bool) -> list[float]:
    """Return the root's distance from the mask's pose, mm, in all and across the view; the axis' angle, deg; and ok."""
    pose = one.result.camera_from_root
    assert pose is not None
    off = 1e3 * (found[:3, 3] - pose[:3, 3])
    along = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    angle = np.degrees(np.arccos(np.clip(found[:3, 2] @ pose[:3, 2], -1.0, 1.0)))
    across = np.linalg.norm(off - (off @ along) * along)
    return [float(np.linalg.norm(off)), float(across), float(angle), float(ok)]
