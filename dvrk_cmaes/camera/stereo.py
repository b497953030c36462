"""The pose of the right camera of a stereo pair as calibration files state it: ``right_from_left`` (4, 4), in metres.

ROS camera_info states the translation between rectified cameras in the fourth column of the right one's P, and the
rotations to them in ``rectification_matrix``; a field ``right_from_left`` added to it states the pose of raw cameras.
OpenCV's ``R`` and ``T``, and kalibr's ``T_cn_cnm1``, map points of the left camera to the right one. OpenCV's lengths
are in the unit of the calibration pattern: metres or millimetres.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dvrk_cmaes.camera.document import chosen_camera, kalibr_cameras, plain_names
from dvrk_cmaes.camera.fields import has_field, take_field, take_numbers
from dvrk_cmaes.camera.rig import BASELINE
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, inverse, transform

Document = Mapping[str, Any]
StereoPose = tuple[Float64, tuple[str, ...]]
"""``right_from_left`` (4, 4), m, and notes on how it was read."""

_NEAREST, _FARTHEST = BASELINE
_OF_AN_ENDOSCOPE = 0.02  # m, largest distance of an endoscope's eyes
_RIGID = 0.01  # tolerance of R R^T = 1, for files that state few digits

_POSE = "right_from_left"
_PROJECTION = ("projection_matrix", "P", "p")
_RECTIFICATION = ("rectification_matrix", "R", "r")
_ROTATION = ("r", "extrinsiccamerarotation", "rotation")
_TRANSLATION = ("t", "extrinsiccameratranslation", "translation")


def has_pose(where: str, right: Document) -> bool:
    """Whether a right camera's file states where it is: ``right_from_left``, or a baseline in P."""
    if right.get(_POSE) is not None:
        return True
    if not has_field(right, _PROJECTION):
        return False
    return bool(take_numbers(where, *take_field(where, right, _PROJECTION), count=12)[3])


def pose_of_camera_infos(where: tuple[str, str], left: Document, right: Document, *, rectified: bool) -> StereoPose:
    """Return the pose between the cameras of two camera_info documents; InputError names a wrong field.

    ``where`` are the names of the two files. Without ``rectified`` it is that of the raw images.
    """
    if right.get(_POSE) is not None:
        raw, notes = pose_of_plain(where[1], right)
        if not rectified:
            return raw, notes
        turns = [_turn(*each) for each in zip(where, (left, right), strict=True)]
        return turns[1] @ raw @ inverse(turns[0]), notes
    name, entry = take_field(where[0], left, _PROJECTION)
    if any(abs(_baseline(where[0], name, entry)) > 1e-9):
        raise InputError(
            f"{where[0]}: {name}: expected the left camera, whose fourth column is zero, got one with a baseline: "
            "left and right are exchanged?"
        )
    name, entry = take_field(where[1], right, _PROJECTION)
    translation = _baseline(where[1], name, entry)
    translation, remarks = _metres(where[1], f"{name}: baseline", translation, millimetres=False)
    if translation[0] > 0:
        raise InputError(
            f"{where[1]}: {name}: expected -f b in the fourth column, with the right eye on the right, "
            f"got +{1e3 * translation[0]:.3g} mm: left and right are exchanged?"
        )
    pose = transform(np.eye(3), translation)
    if rectified:
        return pose, remarks
    turns = [_turn(*each) for each in zip(where, (left, right), strict=True)]
    return inverse(turns[1]) @ pose @ turns[0], remarks


def pose_of_storage(where: str, document: Document, *, rectified: bool) -> StereoPose:
    """Return the pose between the two cameras of an OpenCV FileStorage; InputError names a wrong field.

    Rectified images need ``P2``, raw ones a rotation and a translation.
    """
    plain = plain_names(document)
    if rectified and has_field(plain, ("p2", "rightprojectionmatrix")):
        name, entry = take_field(where, plain, ("p2", "rightprojectionmatrix"))
        translation, notes = _metres(where, name, _baseline(where, name, entry), millimetres=True)
        return transform(np.eye(3), translation), (*notes, *_sides(translation))
    if not (has_field(plain, _ROTATION) and has_field(plain, _TRANSLATION)):
        raise InputError(
            f"{where}: R, T: expected rotation and translation between the two cameras (R and T, or "
            "Extrinsic_Camera_Rotation and Extrinsic_Camera_Translation), got none"
        )
    return _rotation_and_translation(where, plain)


def pose_of_plain(where: str, document: Document) -> StereoPose:
    """Return the pose that the right camera's plain YAML states: ``right_from_left`` (4, 4), or R and T."""
    if document.get(_POSE) is not None:
        matrix = np.reshape(take_numbers(where, _POSE, document[_POSE], count=16), (4, 4))
        return _checked(where, _POSE, matrix, millimetres=False)
    plain = plain_names(document)
    if not (has_field(plain, _ROTATION) and has_field(plain, _TRANSLATION)):
        raise InputError(f"{where}: {_POSE}: missing (expected a 4 x 4 transform, m, or R and T)")
    return _rotation_and_translation(where, plain)


def pose_of_camchain(where: str, document: Document) -> StereoPose:
    """Return the pose between the two cameras of a kalibr camchain; InputError names a wrong field."""
    cameras = kalibr_cameras(document)
    left, right = (chosen_camera(where, cameras, side)[0] for side in ("left", "right"))
    if {left, right} != {"cam0", "cam1"}:
        raise InputError(f"{where}: expected cam0 and cam1 as the two eyes, got {left} and {right}")
    inside = f"{where}: cam1"
    name, entry = take_field(inside, cameras["cam1"], ("T_cn_cnm1",))
    matrix = np.reshape(take_numbers(inside, name, entry, count=16), (4, 4))
    pose, notes = _checked(inside, name, matrix, millimetres=False)
    return (pose, notes) if right == "cam1" else (inverse(pose), _sides(inverse(pose)[:3, 3]))


def _rotation_and_translation(where: str, plain: Document) -> StereoPose:
    """Read R and T under any of their names, given normalised ones."""
    rotation, translation = take_field(where, plain, _ROTATION), take_field(where, plain, _TRANSLATION)
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(take_numbers(where, *rotation, count=9), (3, 3))
    pose[:3, 3] = take_numbers(where, *translation, count=3)
    name = " and ".join(name.upper() if len(name) == 1 else name for name in (rotation[0], translation[0]))
    return _checked(where, name, pose, millimetres=True)


def _checked(where: str, name: str, pose: Float64, *, millimetres: bool) -> StereoPose:
    """Check a pose (4, 4) as stated, convert it to metres and make its rotation exact."""
    rotation = _rotation(where, name, pose[:3, :3])
    translation, notes = _metres(where, name, pose[:3, 3], millimetres=millimetres)
    return transform(rotation, translation), (*notes, *_sides(translation))


def _turn(where: str, document: Document) -> Float64:
    """Read the transform (4, 4) from a raw to its rectified camera."""
    name, entry = take_field(where, document, _RECTIFICATION)
    stated = np.reshape(take_numbers(where, name, entry, count=9), (3, 3))
    return transform(_rotation(where, name, stated), np.zeros(3))


def _rotation(where: str, name: str, stated: Float64) -> Float64:
    """Return the rotation nearest to a stated matrix (3, 3); InputError if that is none."""
    if np.abs(stated @ stated.T - np.eye(3)).max() > _RIGID or np.linalg.det(stated) < 0:
        raise InputError(f"{where}: {name}: expected a rotation matrix, got {stated.tolist()}")
    u, _, v = np.linalg.svd(stated)
    return np.asarray(u @ v)


def _baseline(where: str, name: str, entry: Any) -> Float64:
    """Return the translation (3,) that the fourth column of a projection matrix states, in the file's unit."""
    matrix = np.reshape(take_numbers(where, name, entry, count=12), (3, 4))
    return np.array([matrix[0, 3] / matrix[0, 0], matrix[1, 3] / matrix[1, 1], 0.0])


def _metres(where: str, name: str, translation: Float64, *, millimetres: bool) -> tuple[Float64, tuple[str, ...]]:
    """Return a translation (3,) in metres; ``millimetres``: whether the file may state it in those.

    Of both, the unit is that in which the distance is one of two cameras; from 0.5 on it is millimetres, since two
    cameras half a metre apart see no instrument well.
    """
    distance = float(np.linalg.norm(translation))
    metres = distance if distance < _FARTHEST or not millimetres else distance / 1e3
    if not _NEAREST <= metres <= _FARTHEST:
        unit = "m or mm" if millimetres else "m"
        hint = "" if millimetres or not _NEAREST <= distance / 1e3 <= _FARTHEST else " (is it in millimetres?)"
        raise InputError(
            f"{where}: {name}: expected {_NEAREST:g} to {_FARTHEST:g} m between the cameras, got {distance:g} {unit}"
            f"{hint}"
        )
    notes = [] if metres == distance else [f"the eyes are {distance:.3g} apart: taken for millimetres"]
    if metres > _OF_AN_ENDOSCOPE:
        notes.append(
            f"the cameras are {1e3 * metres:.3g} mm apart, farther than an endoscope's eyes: taken for external cameras"
        )
    return translation * (metres / distance), tuple(notes)


def _sides(translation: Float64) -> tuple[str, ...]:
    """Return a note if the right camera lies on the left of the left one."""
    if translation[0] <= 0:
        return ()
    return (
        f"the file puts the right camera {1e3 * translation[0]:.2g} mm to the left of the left one: "
        "its names may be exchanged",
    )
