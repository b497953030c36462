"""Frames of a rig: the masks, or the images, of all views of one frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, FrameImage, read_frame, read_frame_image


def read_views(files: FrameFiles, rig: Rig) -> FrameData | FrameImage:
    """Read a frame of a rig: the views that have a mask, or those that have an image where none has a mask.

    A view without a mask beside one with a mask gets an empty one.

    Raises
    ------
    InputError
        As `read_frame` and `read_frame_image`; every mask is empty, or no view has a mask or an image.
    """
    if files.problem is not None:
        raise InputError(files.problem)
    of_views = {rig.names[0]: files, **files.others}
    if any(one.mask is not None for one in of_views.values()):
        return _read_masks(of_views, rig)
    images = {
        view.name: read_frame_image(of_views[view.name], view.camera)
        for view in rig.views
        if view.name in of_views and of_views[view.name].image is not None
    }
    if rig.names[0] not in images:
        raise InputError(f"frame {files.name}: expected masks, or an image of the view {rig.names[0]}, got neither")
    main, *others = images.items()
    fitted = rig.with_cameras({name: image.camera for name, image in images.items()})
    return replace(main[1], rig=fitted, others=dict(others))


def _read_masks(of_views: dict[str, FrameFiles], rig: Rig) -> FrameData:
    """Read the masks of the views; InputError if all are empty."""
    found: dict[str, FrameData] = {}
    for view in rig.views:
        one = of_views.get(view.name)
        if one is None or one.mask is None:
            empty = np.zeros((view.camera.height, view.camera.width), np.bool_)
            found[view.name] = FrameData(empty, view.camera, None, None, () if one is None else one.notes)
        else:
            found[view.name] = read_frame(one, view.camera, blank=True)
    if not any(data.mask.any() for data in found.values()):
        named = [str(one.mask) for one in of_views.values() if one.mask is not None]
        raise InputError(f"{', '.join(named)}: mask is empty: expected the instrument in at least one view, got none")
    main, *others = found.items()
    fitted = rig.with_cameras({name: data.camera for name, data in found.items()})
    notes = [f"view {name}: {note}" for name, data in others for note in data.notes if note not in main[1].notes]
    return replace(main[1], rig=fitted, others=dict(others), notes=(*main[1].notes, *notes))
