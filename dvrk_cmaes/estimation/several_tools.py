"""Several instruments in one frame: each is estimated without what the others may hide of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
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
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body

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

    The pixels of the other tools, and those close beside them, count neither way.

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
        The results by name.

    Raises
    ------
    InputError
        As `estimate`; the message begins with the name.
    """
    check_type("tools", tools, Mapping, "a mapping of names to ToolInFrame")
    for name, tool in tools.items():
        check_type(f"tools: {name}", tool, ToolInFrame, "a ToolInFrame")
    seen = {name: _views_of(name, tool, camera, ignore) for name, tool in tools.items()}
    settings = EstimateConfig() if config is None else config
    results = {}
    for name, tool in tools.items():
        others = [views for other, views in seen.items() if other != name]
        views = [_without(view, [of_other[k] for of_other in others]) for k, view in enumerate(seen[name])]
        method, named = FrameMethod(tool.arm, settings, tool.session), isinstance(camera, Rig)
        try:
            results[name] = estimate_views(
                views, tool.joints, tool.instrument, method, named=named, frame=frame, time=time
            )
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
    return results


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
