"""The frames of a session that are followed: which are used, and their masks and images."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Literal

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.images import match_size
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.geometry import Bool, Image

EvidenceKind = Literal["masks", "images"]


def used_session(session: Session, evidence: EvidenceKind | None) -> tuple[Session, EvidenceKind | None]:
    """Return a session with the masks and images that are used, and the evidence that a tracker is to use.

    Without ``evidence`` it is the masks of frames that have one, and the images of the others. The cameras are those of
    the masks' size, or of the images' where no masks are used.

    Raises
    ------
    InputError
        The session has no masks, or no images, where they are asked for; they have another aspect than the camera's.
    """
    masked = any(files.has_mask for files in session.frames)
    shown = any(part.has_image for files in session.frames for part in (files, *files.others.values()))
    if evidence == "masks" and not masked:
        raise InputError(f"{session.folder}: --evidence {evidence}: expected masks of the frames, got none")
    if evidence == "images" and not shown:
        raise InputError(f"{session.folder}: --evidence {evidence}: expected images or video.mp4, got neither")
    if evidence is None and all(files.has_mask for files in session.frames):
        evidence = "masks"
    elif evidence == "images" or not masked:
        evidence = "images"
        session = replace(session, frames=tuple(files.changed(mask=None) for files in session.frames))
    notes, fitted = session.notes, {}
    for view in session.rig.views:
        there = (files_of_views(files, session.rig).get(view.name) for files in session.frames)
        first = next((own for own in there if own is not None), None)
        if first is not None:
            what, path = ("mask", first.mask) if first.mask is not None else ("image", first.picture)
            fitted[view.name], note = match_size(view.camera, first.size[::-1], what, f"{path}: ")
            notes = notes if note is None else (*notes, note)
    return replace(session, rig=session.rig.with_cameras(fitted), notes=notes), evidence


def with_increasing_times(session: Session) -> tuple[Session, tuple[str, ...]]:
    """Return a session without the frames that have the time of the frame before, and their names.

    Raises
    ------
    InputError
        Time goes back at a frame, or stands still at half of the frames; names the file and the first such frame.
    """
    timed = [(files.name, files.time) for files in session.frames if files.time is not None]
    if len(timed) < len(session.frames):
        return session, ()
    source = session.folder / "images.csv"
    where = source if source.exists() else next((file.path for file in session.joint_files), session.folder)
    count = "; a file without times has its frames counted (track.frames_a_second)"
    for (before, earlier), (name, time) in pairwise(timed):
        if time < earlier:
            raise InputError(
                f"{where}: frame {name}: expected a later time than that of frame {before}, {earlier:.6f} s, got "
                f"{time:.6f} s (a clock that was set?): follow the frames before and after by themselves{count}"
            )
    doubled = tuple(name for (_, earlier), (name, time) in pairwise(timed) if time == earlier)
    if 2 * len(doubled) >= len(timed):
        raise InputError(
            f"{where}: frame {doubled[0]}: expected a later time than that of the frame before, got the same, as of "
            f"{len(doubled)} of {len(timed)} frames{count}"
        )
    return replace(session, frames=tuple(files for files in session.frames if files.name not in doubled)), doubled


def files_of_views(files: FrameFiles, rig: Rig) -> dict[str, FrameFiles]:
    """Return the files of a frame by view: of those that have a mask or an image, or of the first if none has."""
    there = {name: own for name, own in files.of_views(rig).items() if own.mask is not None or own.has_image}
    return there or {rig.names[0]: files}


def read_arrays(files: FrameFiles, camera: Camera) -> tuple[Image | None, Bool | None, Bool | None]:
    """Read the image (H, W, 3), if there is one, the mask and the ignored pixels (H, W) of a view of a frame.

    Raises
    ------
    InputError
        A file is wrong, or the mask is not of the camera's size.
    """
    if files.mask is None and files.problem is None and (image := files.read_image()) is not None:
        match_size(camera, image.shape[:2], "image", f"{files.picture}: ")
        return image, None, files.read_ignored(image.shape, "image")  # a tracker looks for the border itself, once
    data, size = read_frame(files, camera, blank=True), (camera.width, camera.height)
    if (data.camera.width, data.camera.height) != size:
        raise InputError(
            f"{files.mask}: expected {camera.width} x {camera.height} pixels as the camera has, got "
            f"{data.camera.width} x {data.camera.height}"
        )
    image = data.image
    if image is not None and image.shape[1::-1] != size:
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return image, data.mask, data.ignore
