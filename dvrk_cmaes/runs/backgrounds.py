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
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.results.paths import found_masks
from dvrk_cmaes.runs.manifest import read_manifest
from dvrk_cmaes.segment.background import FEWEST, MOST, learn_background
from dvrk_cmaes.segment.classic import segment_classic
from dvrk_cmaes.segment.segmentation import GUESS, Hints, SegmentSettings
from dvrk_cmaes.silhouette.threads import map_threaded

Load = Callable[[], NDArray[np.uint8] | None]
"""A function that reads an image, or None where there is none."""

_TRIED: Final = 3  # images in which the instrument is looked for by colours


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
    return _learned(settings, {name: [partial(image_of, own) for own in of_view] for name, of_view in images.items()})


def segment_settings(session: Session, results: Path) -> SegmentSettings | None:
    """Return how the masks of a session were found in its images, given the folder of these results.

    None where it is not known, no mask was found, or not by the classic model.
    """
    manifest = read_manifest(results)
    found = any(not files.has_mask and found_masks(results, files.name) for files in session.frames)
    if manifest is None or not found or manifest.get("segment", {}).get("model") != "classic":
        return None
    return with_backgrounds(SegmentSettings(), session.frames, session.rig.names)


def learned_backgrounds(settings: SegmentSettings, images: Mapping[str, Sequence[Path]]) -> SegmentSettings:
    """Return settings with the backgrounds of images by view, where the camera stands still before the instrument.

    They are used by the classic model alone, and only of views in whose images it does not find the instrument by
    colours. Images that cannot be read do not count.
    """
    return _learned(settings, {name: [partial(read_image, path) for path in paths] for name, paths in images.items()})


def _learned(settings: SegmentSettings, images: Mapping[str, Sequence[Load]]) -> SegmentSettings:
    """Return settings with the backgrounds of images by view, each of which a function loads."""
    if settings.model != "classic":
        return settings
    learned = zip(images, map_threaded(_learn, list(images.values()), len(images)), strict=True)
    return replace(settings, backgrounds={view: found for view, found in learned if found is not None})


def _learn(paths: Sequence[Load]) -> NDArray[np.uint8] | None:
    """Learn the background of the images of one view; None if there is none, or it is not needed."""
    if len(paths) < FEWEST or _found_by_colours(_spread(paths, _TRIED)):
        return None
    return learn_background(_readable(_spread(paths, MOST)))


def _found_by_colours(paths: Sequence[Load]) -> bool:
    """Return whether the instrument is found in images by colours, mostly."""
    sure = [segment_classic(image, Hints()).confidence >= GUESS for image in _readable(paths)]
    return 2 * sum(sure) > len(sure)


def _readable(loads: Sequence[Load]) -> list[NDArray[np.uint8]]:
    """Read the images that can be read."""
    return [image for load in loads if (image := readable(load)) is not None]


def _spread(paths: Sequence[Load], most: int) -> list[Load]:
    """Return at most some of the images, spread evenly over all."""
    return [paths[int(k)] for k in np.unique(np.linspace(0, len(paths) - 1, most).round())]
