"""Several instruments in one frame: each is estimated without what the others may hide of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation.one_tool import FrameMethod, estimate_views
from dvrk_cmaes.frames.frame import with_tool
from dvrk_cmaes.frames.seen_view import Mask, SeenView, seen_views
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.arguments import check_type
from dvrk_cmaes.pose.depth_order import OPPOSITE, place_of_other
from dvrk_cmaes.results.result import Place, Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration


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
    camera
        The camera or a rig, as in `estimate`.
    ignore
        (H, W) bool, pixels that count neither way for any tool; by view with a rig.
    frame
        The frame's name, for the results.
    time
        The time of the image, s, for the results.
    config
        All settings, as in `estimate`.

    Returns
    -------
    dict of str to Result
        The results by name; their ``other_tools`` say where the others are.

    Raises
    ------
    InputError
        As `estimate`; the message begins with the name.
    """
    check_type("tools", tools, Mapping, "a mapping of names to ToolInFrame")
    for name, tool in tools.items():
        check_type(f"tools: {name}", tool, ToolInFrame, "a ToolInFrame")
    seen = {name: _views_of(name, tool, camera, ignore) for name, tool in tools.items()}
    bodies = {name: prepare(tool.instrument) for name, tool in tools.items()}
    settings = EstimateConfig() if config is None else config

    def solve(name: str, hiding: Iterable[str], start: Result | None = None) -> Result:
        tool, views = tools[name], []
        for k, view in enumerate(seen[name]):
            views.append(_without(view, [seen[other][k] for other in hiding]))
        try:
            return estimate_views(
                views,
                tool.joints,
                bodies[name],
                FrameMethod(tool.arm, settings, tool.session),
                named=isinstance(camera, Rig),
                start=start,
                frame=frame,
                time=time,
            )
        except InputError as error:
            raise InputError(f"{name}: {error}") from None

    results = {name: solve(name, [other for other in tools if other != name]) for name in tools}
    places: dict[str, dict[str, Place]] = {name: {} for name in tools}
    for one, other in combinations(tools, 2):
        places[one][other] = place_of_other(
            (results[one], results[other]), (bodies[one], bodies[other]), (seen[one], seen[other])
        )
        places[other][one] = OPPOSITE[places[one][other]]
    for name in tools:
        results[name] = replace(results[name], other_tools=places[name])
        if "behind" in places[name].values():
            hiding = [other for other, place in places[name].items() if place != "behind"]
            results[name] = better_of(results[name], solve(name, hiding, results[name]))
    return results


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


def _without(view: SeenView, others: Iterable[SeenView]) -> SeenView:
    """Return a view in which the pixels of other tools, given by the same view with their masks, do not count."""
    for other in others:
        if other.given:
            view = replace(view, ignore=with_tool(view.ignore, other.mask))
    return view


def _views_of(name: str, tool: ToolInFrame, camera: Camera | Rig, ignore: Mask | None) -> tuple[SeenView, ...]:
    """Return the views of the frame with a tool's masks; InputError, which names the tool, if one is wrong."""
    try:
        views = seen_views(tool.mask, camera, ignore, tool.keypoints)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    for view in views:
        shape = (view.camera.height, view.camera.width)
        for what, picture in ((f"{name}: mask", view.mask), ("ignore", view.ignore)):
            if picture is not None and picture.shape != shape:
                raise InputError(
                    f"{what}: expected {shape[1]} x {shape[0]} pixels as the camera has, got an array of shape "
                    f"{picture.shape}"
                )
    return views
