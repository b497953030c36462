"""Backgrounds that are learned from the images of a whole session, before which its masks are found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.frames.frame import FrameFiles, image_of, readable
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.segment.background import MOST, learn_background
from dvrk_cmaes.segment.segmentation import SegmentSettings
from dvrk_cmaes.silhouette.threads import map_threaded

Load = Callable[[], NDArray[np.uint8] | None]
"""A function that reads an image, or None where there is none."""

_APART: Final = {"insertion": 0.003}  # m, by which readings differ of images that show the tool in another place
_APART_RAD: Final = 0.02  # the same of joints that turn


def with_backgrounds(
    settings: SegmentSettings, frames: Sequence[FrameFiles], views: Sequence[str] = ("",)
) -> SegmentSettings:
    """Return settings with the backgrounds of a session's frames, for the frames that have images and no masks.

    ``views`` are the names of the session's views, the reference first. As `learned_backgrounds`.
    """
    images: dict[str, list[FrameFiles]] = {name: [] for name in views}
    for files in frames:
        for name in views:
            own = files if name == views[0] else files.others.get(name)
            if own is not None and own.mask is None and own.image is not None and own.problem is None:
                images[name].append(own)
    loads = {name: [partial(image_of, own) for own in _moved(of_view)] for name, of_view in images.items()}
    return _learned(settings, {name: of_view for name, of_view in loads.items() if of_view})


def learned_backgrounds(settings: SegmentSettings, images: Mapping[str, Sequence[Path]]) -> SegmentSettings:
    """Return settings with the backgrounds of images by view, where the camera stands still before the instrument.

    They are used by the classic model alone. Images that cannot be read do not count.
    """
    return _learned(settings, {name: [partial(read_image, path) for path in paths] for name, paths in images.items()})


def _learned(settings: SegmentSettings, images: Mapping[str, Sequence[Load]]) -> SegmentSettings:
    """Return settings with the backgrounds of images by view, each of which a function loads."""
    if settings.model != "classic":
        return settings
    learned = dict(zip(images, map_threaded(_learn, list(images.values()), len(images)), strict=True))
    notes = []
    for view, found in learned.items():
        of_view = f"images of {view}" if len(learned) > 1 else "images"
        if not isinstance(found, str):
            notes.append(f"{of_view}: a background was learned from {len(images[view])} of them")
        elif len(images[view]) > 1:
            notes.append(f"{of_view}: no background was learned: {found}")
    backgrounds = {view: found for view, found in learned.items() if not isinstance(found, str)}
    return replace(settings, backgrounds=backgrounds, notes=tuple(notes))


def _learn(images: Sequence[Load]) -> NDArray[np.uint8] | str:
    """Learn the background of the images of one view, or return why there is none."""
    return learn_background([image for load in _spread(images, MOST) if (image := readable(load)) is not None])


def _moved(frames: Sequence[FrameFiles]) -> list[FrameFiles]:
    """Return the frames whose readings differ from those of all frames before in the list; all without readings."""
    kept: list[FrameFiles] = []
    for files in frames:
        if all(_differ(files.readings, other.readings) for other in kept):
            kept.append(files)
    return kept


def _differ(first: Mapping[str, float], second: Mapping[str, float]) -> bool:
    """Whether the readings of two frames show the tool in two places; True where they have none in common."""
    common = first.keys() & second.keys()
    return not common or any(abs(first[name] - second[name]) > _APART.get(name, _APART_RAD) for name in common)


def _spread(images: Sequence[Load], most: int) -> list[Load]:
    """Return at most some of the images, spread evenly over all."""
    return [images[int(k)] for k in np.unique(np.linspace(0, len(images) - 1, most).round())]
