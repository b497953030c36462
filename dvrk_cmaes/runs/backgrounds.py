"""Backgrounds that are learned from the images of a whole session, before which its masks are found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.frames.frame import FrameFiles, readable
from dvrk_cmaes.segment.background import MOST, learn_background
from dvrk_cmaes.segment.segmentation import SegmentSettings
from dvrk_cmaes.silhouette.threads import map_threaded

_APART: Final = {"insertion": 0.003}  # m, by which readings differ of images that show the tool in another place
_APART_RAD: Final = 0.02  # the same of joints that turn


def with_backgrounds(settings: SegmentSettings, frames: Mapping[str, Sequence[FrameFiles]]) -> SegmentSettings:
    """Return settings with the backgrounds of frames by view, learned from those that have images and no masks.

    The camera stands still before the instrument. Backgrounds are used by the classic model alone. Images that cannot
    be read do not count.
    """
    if settings.model != "classic":
        return settings
    # those whose masks are to be found in their images
    given = {
        name: [own for own in of_view if own.mask is None and own.has_image and own.problem is None]
        for name, of_view in frames.items()
    }
    images = {name: _moved(of_view) for name, of_view in given.items() if of_view}
    pictures = [_pictures(of_view) for of_view in images.values()]
    learned = dict(zip(images, map_threaded(learn_background, pictures, len(images)), strict=True))
    notes = []
    for view, found in learned.items():
        of_view = f"images of {view}" if len(learned) > 1 else "images"
        if not isinstance(found, str):
            notes.append(f"{of_view}: a background was learned from {len(images[view])} of them")
        elif len(given[view]) > 1:
            same = len(given[view]) - len(images[view])
            more = f"; {same} more show the instrument in the same places, by their readings" if same else ""
            notes.append(f"{of_view}: no background was learned: {found}{more}")
    backgrounds = {view: found for view, found in learned.items() if not isinstance(found, str)}
    return replace(settings, backgrounds=backgrounds, notes=tuple(notes))


def by_view(frames: Sequence[FrameFiles], rig: Rig) -> dict[str, list[FrameFiles]]:
    """Return the files of frames by the view of a rig that they are of."""
    return {name: [files.of_views(rig)[name] for files in frames] for name in rig.names}


def _pictures(frames: Sequence[FrameFiles]) -> list[NDArray[np.uint8]]:
    """Read the images of one view from which its background is learned: of many, some spread evenly."""
    chosen = (frames[int(k)] for k in np.unique(np.linspace(0, len(frames) - 1, MOST).round()))
    images = (readable(files.read_image) for files in chosen)
    return [image for image in images if image is not None]


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
