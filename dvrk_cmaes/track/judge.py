"""Whether an image supports a followed pose, and the reasons for which a pose is doubtful."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.geometry import apply
from dvrk_cmaes.pose.doubts import outside_image
from dvrk_cmaes.track.hypothesis import Located
from dvrk_cmaes.track.update import Fit

Float64 = NDArray[np.float64]

AWAY = "readings against outline: the pose was found away from where they say"


def is_supported(fit: Fit, config: TrackConfig) -> bool:
    """Whether an image supports a pose at all; otherwise the pose is lost."""
    return fit.supported >= config.least_support and fit.unexplained <= config.most_unexplained


def is_convincing(fit: Fit, config: TrackConfig) -> bool:
    """Whether an image supports a pose so well that no other is to be searched for."""
    return fit.supported >= config.good_support and fit.unexplained <= config.good_unexplained


def doubts_of_fit(fit: Fit, config: TrackConfig, source: str, views: Sequence[str]) -> list[str]:
    """List the reasons, in words, for which a supported pose does not fit its ``source``, mask or image, well.

    ``views`` are the names of the rig's views; a pose has to fit in each of those that were compared.
    """
    doubts = []
    for view, (supported, unexplained) in fit.of_views.items():
        name = f"view {views[view]}: " if len(views) > 1 else ""
        doubts += [f"{name}{text}" for text in _doubts_of_view(supported, unexplained, config, source)]
    return doubts


def _doubts_of_view(supported: float, unexplained: float, config: TrackConfig, source: str) -> list[str]:
    """List the reasons of one view, given its shares as in `Fit`."""
    doubts = []
    if supported < config.good_support:
        share = 100 * (1 - supported)
        doubts.append(f"outline without edge: {share:.0f} % of it has no edge of the {source} near it")
    if unexplained > config.good_unexplained:
        share = 100 * unexplained
        doubts.append(
            f"edge without outline: {share:.0f} % of the mask's edge has no outline near it"
            if source == "mask"
            else f"colours without outline: the instrument's go on beside {share:.0f} % of it"
        )
    return doubts


def doubts_of_pose(located: Located, rig: Rig, config: TrackConfig) -> list[str]:
    """List the reasons, in words, for which a pose is not known well enough."""
    doubts = []
    if located.tip_std * 1e3 > config.largest_tip_mm:
        doubts.append(f"uncertain: the standard deviation of the jaw tips is {located.tip_std * 1e3:.1f} mm")
    if tips_out_of_view(located.tips, rig):
        doubts.append("tip out of view: the jaw tips lie outside the image")
    return doubts


def tips_out_of_view(tips: Float64, rig: Rig) -> bool:
    """Whether all jaw tips (K, 3) lie outside the image, or behind the camera, of every view."""
    return bool(len(tips)) and not any(
        not outside_image(apply(view.view_from_camera, tips) if number else tips, view.camera).all()
        for number, view in enumerate(rig.views)
    )
