"""Several instruments in one frame: each is estimated without what the others may hide of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation.one_tool import estimate
from dvrk_cmaes.frames.frame import with_tool
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.pose.depth_order import OPPOSITE, SharedView, place_of_other
from dvrk_cmaes.pose.seen_views import Mask
from dvrk_cmaes.results.result import Place, Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare

Bool = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ToolInFrame:
    """One of several instruments that a frame shows: its mask, readings and kind, as the arguments of `estimate`."""

    mask: Mask
    joints: Mapping[str, float] | None = None
    instrument: Instrument | Body | str = "lnd"
    keypoints: ArrayLike | Mapping[str, ArrayLike | None] | None = None
    arm: Arm = "classic"
    session: SessionCalibration | None = None


def estimate_tools(
    tools: Mapping[str, ToolInFrame],
    camera: Camera | Rig,
    *,
    ignore: Mask | None = None,
    frame: str = "",
    time: float | None = None,
    config: EstimateConfig | None = None,
) -> dict[str, Result]:
    """Estimate the poses of several instruments in one frame, each without what the others may hide of it.

    Each is first estimated without the pixels of the others, which count neither way. A tool that is then clearly in
    front of another one, wherever the two meet, hides it and shows its own outline: it is refined with the pixels of
    that other one as background. Its result stays as it was if that would make it doubtful.

    Parameters
    ----------
    tools
        The instruments by a name, such as that of their arm.
    camera, ignore, frame, time, config
        As in `estimate`.

    Returns
    -------
    dict of str to Result
        The results by name; their ``other_tools`` say where the others are.

    Raises
    ------
    InputError
        As `estimate`; the message begins with the name.
    """
    masks = {name: _masks_of_views(f"{name}: mask", tool.mask, camera) for name, tool in tools.items()}
    general = {} if ignore is None else _masks_of_views("ignore", ignore, camera)
    bodies = {
        name: tool.instrument if isinstance(tool.instrument, Body) else prepare(tool.instrument)
        for name, tool in tools.items()
    }
    settings = EstimateConfig() if config is None else config

    def solve(name: str, hiding: Iterable[str], start: Result | None = None) -> Result:
        tool = tools[name]
        ignored = {view: _ignored(general.get(view), [masks[o].get(view) for o in hiding]) for view in masks[name]}
        try:
            return estimate(
                tool.mask,
                camera,
                tool.joints,
                bodies[name],
                ignore=ignored if isinstance(camera, Rig) else next(iter(ignored.values())),
                keypoints=tool.keypoints,
                arm=tool.arm,
                session=tool.session,
                start=start,
                frame=frame,
                time=time,
                config=settings,
            )
        except InputError as error:
            raise InputError(f"{name}: {error}") from None

    results = {name: solve(name, [other for other in tools if other != name]) for name in tools}
    places: dict[str, dict[str, Place]] = {name: {} for name in tools}
    for one, other in combinations(tools, 2):
        places[one][other] = place_of_other(
            (results[one], results[other]),
            (bodies[one], bodies[other]),
            shared_views(Rig.of(camera), masks[one], masks[other]),
            least_probability=settings.trust.least_mode_probability,
        )
        places[other][one] = OPPOSITE[places[one][other]]
    for name in tools:
        results[name] = replace(results[name], other_tools=places[name])
        if "behind" in places[name].values():
            hiding = [other for other, place in places[name].items() if place != "behind"]
            results[name] = better_of(results[name], solve(name, hiding, results[name]))
    return results


def shared_views(rig: Rig, first: Mapping[str, Bool], second: Mapping[str, Bool]) -> list[SharedView]:
    """Return the views in which both of two tools have a mask, given their masks (H, W) by view."""
    return [
        SharedView(view.camera, view.view_from_camera, (first[view.name], second[view.name]))
        for view in rig.views
        if view.name in first and view.name in second
    ]


def better_of(first: Result, again: Result) -> Result:
    """Return the second result of a frame, for which tools behind this one count as background, or the first one.

    The first stays where the second is doubtful and the first is not; it then says so. ``other_tools`` are those of the
    first, times and counts those of both.
    """
    both = {name: getattr(first, name) + getattr(again, name) for name in ("seconds", "evaluations", "rays")}
    if first.status == "ok" and again.status != "ok":
        reason = f"other tools behind this one as background: the pose would be doubtful ({again.reasons[0]})"
        return replace(first, unused=(*first.unused, reason), **both)
    return replace(again, other_tools=first.other_tools, **both)


def _ignored(general: Bool | None, others: Iterable[Bool | None]) -> Bool | None:
    """Return the pixels (H, W) that count neither way: those of all frames, and those of other tools' masks."""
    for other in others:
        general = general if other is None else with_tool(general, other)
    return general


def _masks_of_views(what: str, masks: Mask, camera: Camera | Rig) -> dict[str, Bool]:
    """Return masks (H, W) by name of the view, without views that have none; InputError for one of another size."""
    rig, found = Rig.of(camera), {}
    given = masks if isinstance(masks, Mapping) else {rig.names[0]: masks}
    for view in rig.views:
        mask, shape = given.get(view.name), (view.camera.height, view.camera.width)
        if mask is None:
            continue
        found[view.name] = np.asarray(mask, dtype=np.bool_)
        if found[view.name].shape != shape:
            raise InputError(
                f"{what}: expected {shape[1]} x {shape[0]} pixels as the camera has, got an array of shape "
                f"{found[view.name].shape}"
            )
    return found
