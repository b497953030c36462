"""An endoscope that moves during a session: how each frame's camera_from_base follows from one of them.

``relative`` (N, 4, 4) is the pose of the reference camera in the camera of each frame, so that a frame's
camera_from_base is ``relative @ camera_from_base``. It is a function of M unknowns, which all frames share: with
readings of the endoscope's arm (ECM), of the camera in the endoscope's tip, the offsets of the ECM's joints, and the
errors of its readings at each place where it stands; without readings, of the place of each piece of the session.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.blocks import ENDOSCOPE, Calibration, PredictedBlock
from dvrk_cmaes.geometry import (
    Float64,
    Indices,
    adjoint,
    change_between,
    exp_rotation,
    inverse,
    moved,
    rotation_about_z,
    transform,
)
from dvrk_cmaes.instrument.endoscope import STRAIGHT, ecm_from_tip_and_jacobian
from dvrk_cmaes.io.typed_document import Number
from dvrk_cmaes.pose.refine.information import times

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.model import SessionModel

OFFSET_STD: Final = np.array([np.deg2rad(3.0), np.deg2rad(3.0), 0.005, np.deg2rad(3.0)])
"""Prior standard deviations of the offsets of the ECM's joints, rad and m."""

PLACE_STD: Final = np.sqrt(2) * np.array([np.deg2rad(0.3), np.deg2rad(0.3), 0.0005, np.deg2rad(0.3)])
"""Those of the errors of its readings at a place, against that at the reference, in all of these: cables, sag."""

HAND_EYE_STD: Final = np.array([0.005, 0.005, 0.010, np.deg2rad(4.0), np.deg2rad(4.0), np.deg2rad(30.0)])
"""Those of the camera in the endoscope's tip, along and about the tip's axes, m, rad; the last is a turn about it."""

_PIECE_STD: Final = np.array([0.1, 0.1, 0.1, 1.0, 1.0, 1.0])  # of a piece's camera against the reference, m, rad
_TILTS: Final = np.deg2rad([0.0, 30.0, -30.0])  # of cameras that look straight, down and up
_TURNS: Final = np.deg2rad(np.arange(-150.0, 181.0, 30.0))
_NOISE: Final = np.array([np.deg2rad(0.02), np.deg2rad(0.02), 3e-5, np.deg2rad(0.02)])  # least, from frame to frame
_MOST_NOISE: Final = np.array([np.deg2rad(0.5), np.deg2rad(0.5), 8e-4, np.deg2rad(0.5)])
_SAME: Final = 4.0  # standard deviations of that, within which readings are of one place
_STANDS: Final = 3  # frames, from which on a place is one where the endoscope stands


@dataclass(frozen=True, eq=False)
class EndoscopeValues:
    """Values of the M unknowns: first ``poses`` (Q, 4, 4), m, then ``numbers``.

    Of an endoscope whose arm is read, the only pose is the camera in its tip. The numbers are the offsets of the ECM's
    joints (4,), then what is added to its readings at P places but the reference (P, 4): true = reading + offset +
    error, rad and m. Of one that is not read, the poses are the reference camera in that of each other piece.
    """

    poses: Float64
    numbers: Float64

    @property
    def tip_from_camera(self) -> Float64:
        """The camera (4, 4) in the tip of an endoscope whose arm is read, m."""
        return np.asarray(self.poses[0])

    @property
    def errors(self) -> Float64:
        """What is added to the readings (P + 1, 4) at the reference, where it is zero, and at P other places."""
        return np.append(np.zeros(4), self.numbers[4:]).reshape(-1, 4)


class EndoscopeBlock(PredictedBlock):
    """The M unknowns of an endoscope that moves.

    ``expected`` (Q, 4, 4) are the prior means of the poses, of whose changes along and about the axes that they are in
    ``std`` (M,) are the first standard deviations; numbers are expected to be zero.
    """

    def __init__(self, expected: Float64, std: Float64) -> None:
        super().__init__(ENDOSCOPE, std)
        self.expected = expected

    @classmethod
    def read(cls, expected: Float64, places: int) -> EndoscopeBlock:
        """Return the block of an endoscope whose arm is read, with the prior mean (4, 4) of the camera in its tip.

        The errors at all ``places`` but the reference have that of the reference in them.
        """
        found = cls(expected[None], np.concatenate([HAND_EYE_STD, OFFSET_STD, np.tile(PLACE_STD, places - 1)]))
        alike = 2 * (np.eye(places - 1) - 1 / places)  # the inverse of (1 + identity) / 2
        found.information[10:, 10:] = np.kron(alike, np.diag(PLACE_STD**-2.0))
        return found

    def in_common(self) -> EndoscopeBlock:
        """Return the same as a block that the arms of a session share."""
        found = copy(self)
        found.shared = True
        return found

    def deviation(self, value: Any) -> Float64:
        """Return the differences from the prior means."""
        turns = times(in_tip(self.expected), change_between(self.expected, value.poses))
        return np.concatenate([turns.ravel(), value.numbers])

    def changed(self, value: Any, step: Float64) -> EndoscopeValues:
        """Return the values after a step."""
        count = 6 * len(value.poses)
        turned = moved(value.poses, times(in_tip(value.poses).swapaxes(1, 2), step[:count].reshape(-1, 6)))
        return EndoscopeValues(turned, value.numbers + step[count:])

    def derivative(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes of the roots' poses by that of the camera."""
        assert model.endoscope is not None
        moves = model.endoscope.relative(calibration.values[self.name])[1]
        return np.pad(model.root_from_camera(calibration) @ moves, ((0, 0), (0, len(model.names)), (0, 0)))


@dataclass(frozen=True, eq=False)
class _Moving(ABC):
    """Where the endoscope is in each of N frames, as a function of the values of the M unknowns of a ``block``.

    ``start`` are the values from which an estimation starts, ``loose`` (M,) their standard deviations.
    """

    block: EndoscopeBlock
    start: EndoscopeValues
    loose: Float64

    @abstractmethod
    def relative(self, values: EndoscopeValues) -> tuple[Float64, Float64, Float64]:
        """Compute the reference camera's pose (N, 4, 4) in each frame's camera, m, and its changes in its own axes.

        These are (N, 6, M) by the unknowns, and (N, 6, 4) by a standard deviation of a frame's own errors.
        """


Row = tuple[Number, ...]


@dataclass(frozen=True)
class Place:
    """A place at which the endoscope stands: its ``readings`` (4,), and how far ``within`` these (4,) others are of it.

    ``error`` (4,) is what is added to the readings there, once it is known.
    """

    readings: Row
    within: Row
    error: Row = (0.0,) * 4


@dataclass(frozen=True, eq=False)
class Steered(_Moving):
    """An endoscope whose arm is read, in N frames.

    ``read`` (N, 4) are the readings, rad and m, ``places`` where it stands, the first of which is the reference. While
    it is moved, its readings have the error of the nearest place, and one of their own (`loadings`).
    """

    read: Float64
    places: tuple[Place, ...]

    @classmethod
    def of(cls, read: Float64, places: Sequence[Place] = ()) -> Steered | None:
        """Return the endoscope of frames with readings (N, 4), NaN without one; None if it is not read, or stands.

        ``places`` are those at which it stands, where they are known.
        """
        read = filled(read)
        places = tuple(places) or find_places(read)
        if np.isnan(read).any() or not len(read):
            return None
        if not places:  # it moves all the time
            places = (Place(tuple(np.median(read, axis=0).tolist()), (0.0,) * 4),)
        if len(places) == 1:
            away = (np.abs(read - places[0].readings) > np.maximum(places[0].within, _NOISE)).any(axis=1)
            if np.convolve(away, np.ones(_STANDS), "valid").max(initial=0.0) != _STANDS:  # single ones are noise
                return None
        block = EndoscopeBlock.read(STRAIGHT, len(places))
        return cls(block, EndoscopeValues(STRAIGHT[None], np.zeros(4 * len(places))), block.std, read, places)

    @cached_property
    def _away(self) -> Float64:
        """How far (N, P + 1) the readings are from those at each place, as a share of how far others of it are."""
        readings, within = (np.array([getattr(one, name) for one in self.places]) for name in ("readings", "within"))
        return np.asarray((np.abs(self.read[:, None] - readings) / np.maximum(within, 1e-12)).max(axis=2))

    @property
    def place(self) -> Indices:
        """Number (N,) of the place at which the endoscope stands in each frame; -1 while it is moved."""
        return np.where(self._away.min(axis=1) <= 1, self._away.argmin(axis=1), -1)

    def at(self, read: Float64) -> Steered:
        """Return the endoscope with other readings (N, 4) of the frames; a frame without has those of its neighbour."""
        return replace(self, read=filled(read))

    def cameras(self, values: EndoscopeValues) -> tuple[Float64, Float64]:
        """Compute the camera (1 + N, 4, 4) in the frame of the ECM, m, at the reference place and in each frame.

        Also returned are its changes (1 + N, 6, M) in its own axes by the unknowns.
        """
        readings, nearest = np.array([one.readings for one in self.places]), self._away.argmin(axis=1)
        read = np.where(self.place[:, None] >= 0, readings[nearest], self.read)
        numbers = np.eye(4 * len(readings)).reshape(-1, 4, 4 * len(readings))  # what the offsets and errors add
        numbers[1:] += numbers[0]
        by_numbers = numbers[np.append(0, nearest)]
        tip, by_joints = ecm_from_tip_and_jacobian(np.vstack([readings[:1], read]) + by_numbers @ values.numbers)
        by_numbers = adjoint(inverse(values.tip_from_camera)) @ by_joints @ by_numbers
        by_hand_eye = np.broadcast_to(in_tip(values.tip_from_camera).T, (len(tip), 6, 6))
        return tip @ values.tip_from_camera, np.concatenate([by_hand_eye, by_numbers], axis=2)

    def relative(self, values: EndoscopeValues) -> tuple[Float64, Float64, Float64]:
        """Compute the reference camera's pose in each frame's camera, and its changes, as of `_Moving`."""
        cameras, changes = self.cameras(values)
        relative = inverse(cameras[1:]) @ cameras[0]
        by_own = -adjoint(inverse(relative)) @ changes[1:]
        errors = np.where((self.place < 0)[:, None, None], by_own[:, :, 6:10] * PLACE_STD, 0.0)
        return relative, changes[0] + by_own, errors

    def subset(self, index: Sequence[int] | NDArray[np.integer]) -> Steered:
        """Return the endoscope in the frames at some indices."""
        return replace(self, read=self.read[index])

    def hand_eyes(self) -> list[Steered]:
        """Return the endoscope with cameras in its tip that may be, at any turn about its axis.

        The turn is known to half of the distance between these.
        """
        loose = self.block.std.copy()
        loose[5] = (_TURNS[1] - _TURNS[0]) / 2
        poses = [
            STRAIGHT @ transform(rotation_about_z(turn) @ exp_rotation([tilt, 0.0, 0.0]), np.zeros(3))
            for tilt in _TILTS
            for turn in _TURNS
        ]
        each = [(EndoscopeBlock.read(pose, len(self.places)), replace(self.start, poses=pose[None])) for pose in poses]
        return [replace(self, block=block, start=start, loose=loose) for block, start in each]


@dataclass(frozen=True, eq=False)
class Pieces(_Moving):
    """An endoscope that is not read, in N frames, each in a piece (N,) of the session, which is its ``place``.

    Piece 0 is the reference.
    """

    place: Indices

    @classmethod
    def of(cls, piece: Indices, cameras: Float64) -> Pieces:
        """Return the endoscope of frames in pieces, with the reference camera in those of the others (P, 4, 4), m."""
        std = np.tile(_PIECE_STD, len(cameras))
        return cls(EndoscopeBlock(cameras, std), EndoscopeValues(cameras, np.zeros(0)), 0.1 * std, piece)

    def relative(self, values: EndoscopeValues) -> tuple[Float64, Float64, Float64]:
        """Compute the reference camera's pose in each frame's camera, and its changes, as of `_Moving`."""
        count = len(values.poses)
        moves = np.zeros((1 + count, 6, count, 6))
        moves[np.arange(count) + 1, :, np.arange(count)] = in_tip(values.poses).swapaxes(1, 2)
        poses = np.concatenate([np.eye(4)[None], values.poses])
        return poses[self.place], moves.reshape(1 + count, 6, -1)[self.place], np.zeros((len(self.place), 6, 4))

    def subset(self, index: Sequence[int] | NDArray[np.integer]) -> Pieces:
        """Return the endoscope in the frames at some indices."""
        return replace(self, place=self.place[index])


Endoscope = Steered | Pieces
"""Where an endoscope that moves is in some frames."""


def find_places(read: Float64) -> tuple[Place, ...]:
    """Find the places at which an endoscope stands in frames with readings (N, 4), in the order of time.

    Readings are of one place if they are within what they scatter from one frame to the next.
    """
    if len(read) < 2 or np.isnan(read).any():
        return ()
    steps = np.abs(np.diff(read, axis=0))
    noise = np.maximum(np.quantile(steps, 0.25, axis=0) / 0.45, _NOISE)  # of a normal distribution's differences
    if (noise > _MOST_NOISE).any():
        return ()
    groups: list[list[int]] = []
    for frame, row in enumerate(read):
        near = [group for group in groups if (np.abs(row - read[group].mean(axis=0)) <= _SAME * noise).all()]
        if near:
            max(near, key=len).append(frame)
        else:
            groups.append([frame])
    within = tuple((_SAME * noise).tolist())
    found = [group for group in groups if len(group) >= _STANDS]
    return tuple(Place(tuple(read[group].mean(axis=0).tolist()), within) for group in found)


def filled(read: Float64) -> Float64:
    """Return readings (N, 4) of which those of a frame without are those of the nearest frame that has some."""
    known = np.flatnonzero(~np.isnan(read).any(axis=1))
    if not len(known) or len(known) == len(read):
        return read
    return np.asarray(read[known[np.abs(np.arange(len(read))[:, None] - known).argmin(axis=1)]])


def in_tip(tip_from_camera: Float64) -> Float64:
    """Return the matrices (..., 6, 6) that turn changes along and about the axes of cameras to those of their tips."""
    out = np.zeros((*tip_from_camera.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = tip_from_camera[..., :3, :3]
    return out
