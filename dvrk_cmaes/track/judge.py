"""Whether an image supports a followed pose, and the reasons for which a pose is doubtful."""

from __future__ import annotations

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.track.hypothesis import Located
from dvrk_cmaes.track.update import Fit


def is_supported(fit: Fit, config: TrackConfig) -> bool:
    """Whether an image supports a pose at all; otherwise the pose is lost."""
    return fit.supported >= config.least_support and fit.unexplained <= config.most_unexplained


def is_convincing(fit: Fit, config: TrackConfig) -> bool:
    """Whether an image supports a pose so well that no other is to be searched for."""
    return fit.supported >= config.good_support and fit.unexplained <= config.good_unexplained


def doubts_of_fit(fit: Fit, config: TrackConfig, source: str) -> list[str]:
    """List the reasons, in words, for which a supported pose does not fit its ``source``, mask or image, well."""
    found = []
    if fit.supported < config.good_support:
        share = 100 * (1 - fit.supported)
        found.append(f"outline without edge: {share:.0f} % of it has no edge of the {source} near it")
    if fit.unexplained > config.good_unexplained:
        share = 100 * fit.unexplained
        found.append(
            f"edge without outline: {share:.0f} % of the mask's edge has no outline near it"
            if source == "mask"
            else f"colours without outline: the instrument's go on beside {share:.0f} % of it"
        )
    return found


def doubts_of_pose(located: Located, camera: Camera, config: TrackConfig) -> list[str]:
    """List the reasons, in words, for which a pose is not known well enough."""
    found = []
    if located.tip_std * 1e3 > config.largest_tip_mm:
        found.append(f"uncertain: the standard deviation of the jaw tips is {located.tip_std * 1e3:.1f} mm")
    if tips_out_of_view(located, camera):
        found.append("tip out of view: the jaw tips lie outside the image")
    return found


def tips_out_of_view(located: Located, camera: Camera) -> bool:
    """Whether all jaw tips lie outside the image or behind the camera."""
    tips = located.tips
    if not len(tips):
        return False
    if (tips[:, 2] <= 0).any():
        return True
    pixels = camera.project(tips)
    outside = (pixels < -0.5) | (pixels > [camera.width - 0.5, camera.height - 0.5])
    return bool(outside.any(axis=1).all())
