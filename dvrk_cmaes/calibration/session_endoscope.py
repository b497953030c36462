"""An endoscope that moves in a session: the search for the camera in its tip or for pieces, and what is stated of it.

The search is by what the frames' own modes agree on; `SessionEndoscope` has places and the camera in the tip as in
``session.json``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.blocks import ENDOSCOPE, Calibration
from dvrk_cmaes.calibration.consensus import ArmModes, Consensus, agreement, evenly_spaced, find_consensus
from dvrk_cmaes.calibration.endoscope import (
    OFFSET_STD,
    Endoscope,
    EndoscopeBlock,
    EndoscopeValues,
    Pieces,
    Place,
    Row,
    Steered,
    filled,
)
from dvrk_cmaes.calibration.session_frame import SessionFrame
from dvrk_cmaes.calibration.session_problem import ArmSession
from dvrk_cmaes.calibration.solve import solve_with_modes
from dvrk_cmaes.geometry import Float64, Indices, adjoint, inverse, log_rotation
from dvrk_cmaes.instrument.endoscope import STRAIGHT
from dvrk_cmaes.io.encode import SIGNIFICANT, Document
from dvrk_cmaes.io.short_text import natural
from dvrk_cmaes.io.typed_document import Count, Number, Transform, convert_document, read_variances, refused
from dvrk_cmaes.joints.names import ECM_JOINTS

_HYPOTHESIS_FRAMES, _TEST_FRAMES = 10, 60  # of each consensus of the search
_TRIED: Final = 4  # cameras in the tip by which the frames agree best, that are refined
_FOUND: Final = 0.3  # of the prior's deviations: those of a refined camera in the tip
LEAST_PIECE: Final = 3
"""Frames that agree on the base of a piece."""
_LEAST_WINDOW, _MOST_WINDOWS = 4, 30  # frames of a run that is solved by itself, and number of these
_AGREE: Final = 0.75  # share of a run's frames that agree on one base
_CHANGE: Final = 12.0  # penalty for a change of the base, where a frame that is off costs at most 4


def find_hand_eye(arm: ArmModes, steered: Steered) -> Steered:
    """Find the camera in the endoscope's tip by which the frames' modes agree best, at any turn about the axis.

    Parameters
    ----------
    arm
        The frames.
    steered
        The endoscope in all frames, whose camera is not known yet.
    """
    few = evenly_spaced(len(arm.counts), _TEST_FRAMES)
    arm = replace(arm, model=replace(arm.model, endoscope=None)).subset(few)

    def consensus(offered: Steered) -> tuple[ArmModes, Consensus]:
        with_it = replace(arm, model=replace(arm.model, endoscope=offered.subset(few)))
        return with_it, find_consensus(with_it, hypothesis_frames=_HYPOTHESIS_FRAMES)

    tried = [(offered, *consensus(offered)) for offered in steered.hand_eyes()]
    refined = list[tuple[float, Steered]]()
    for offered, with_it, agreed in sorted(tried, key=lambda one: one[-1].mean_misfit)[:_TRIED]:
        values = solve_with_modes(with_it, agreed.calibration).calibration.endoscope
        assert values is not None
        there = replace(offered, start=values, loose=_FOUND * offered.loose)
        refined.append((float(consensus(there)[1].cost.mean()), there))
    return min(refined, key=lambda one: one[0])[1]


def find_pieces(arm: ArmModes, consensus: Consensus, alike: float) -> Pieces | None:
    """Find the pieces of a session whose base or camera moved without readings that show, None if it stood still.

    A change-point search: the pieces are those of least cost, the sum of the frames' robust costs at the base of their
    piece and of a penalty for each change. Bases to choose from are those of short runs of consecutive frames, solved
    by themselves.

    Parameters
    ----------
    arm
        The frames in the order they were taken.
    consensus
        The consensus of all frames.
    alike
        Number of frames that count as one, because their masks err alike: what they cost counts as much less.

    Returns
    -------
    Pieces or None
        The pieces of all frames, of which that with most frames is the reference.
    """
    off = ~consensus.agree
    runs = np.convolve(off, np.ones(LEAST_PIECE), "valid") if len(off) >= LEAST_PIECE else np.zeros(0)
    if not (runs == LEAST_PIECE).any():  # no consecutive frames disagree together
        return None
    bases = _bases_of_runs(arm, float(consensus.calibration.offsets[1]))
    if not bases:
        return None
    costs = np.array([agreement(arm, base).cost for base in bases]) / alike
    held, number, counts = np.unique(_fewest_changes(costs), return_inverse=True, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    first, *others = (bases[k].camera_from_base for k in held[order])
    moves = np.array([base @ inverse(first) for base in others])
    return Pieces.of(np.argsort(order)[number], moves) if others else None


def _bases_of_runs(arm: ArmModes, roll: float) -> list[Calibration]:
    """Return the bases of short runs of consecutive frames that agree on one; arguments as in `find_consensus`."""
    count, found = len(arm.counts), list[Calibration]()
    length = max(_LEAST_WINDOW, -(-count // _MOST_WINDOWS))
    for first in range(0, max(count - length, 0) + 1, max(length // 2, 1)):
        index = list(range(first, min(first + length, count)))
        own = arm.subset(index)
        solution = solve_with_modes(own, find_consensus(own, roll=roll).calibration)
        if solution.agree.sum() >= max(LEAST_PIECE, _AGREE * len(index)):
            found.append(solution.calibration)
    return found


def describe_pieces(pieces: Pieces, frames: Sequence[SessionFrame]) -> str:
    """Say between which frames the base or the camera moved."""
    cuts = np.flatnonzero(np.diff(pieces.place)).tolist()
    between = ", ".join(f"{frames[i].name} and {frames[i + 1].name}" for i in cuts)
    return (
        f"the arm's base or the camera moved between frames {between}: {len(pieces.start.poses) + 1} bases, and all "
        "else is shared"
    )


def _fewest_changes(costs: Float64) -> Indices:
    """Return which of B bases holds for each of N consecutive frames, by their costs (B, N) and those of changes.

    Found by dynamic programming.
    """
    total, came = costs[:, 0], list[Indices]()
    for of_frame in costs.T[1:]:
        stays = total <= total.min() + _CHANGE
        came.append(np.where(stays, np.arange(len(costs)), total.argmin()))
        total = np.minimum(total, total.min() + _CHANGE) + of_frame
    out = [int(total.argmin())]
    for before in reversed(came):
        out.append(int(before[out[-1]]))
    return np.array(out[::-1], np.intp)


UNDETERMINED_ROTATION: Final = np.deg2rad(5.0)
"""Standard deviation, rad, of the base or the camera in the tip, beyond which a session does not determine it."""
_BEFORE: Final = 0.7  # of the prior's deviations, from which on an offset is not determined


@dataclass(frozen=True, eq=False)
class Stand:
    """Consecutive frames in which the endoscope stood at a place, from ``first`` to ``last``.

    ``start`` and ``end`` are the times of these, s, None where unknown. ``place`` is the number of the place, 0 that of
    the reference, and ``camera_from_base`` the base from there.
    """

    place: Count
    first: str
    last: str
    camera_from_base: Transform
    start: Number | None = None
    end: Number | None = None


@dataclass(frozen=True, eq=False)
class SessionEndoscope(Document):
    """An endoscope that moved during a session; m, rad, and readings in the order of the ECM's joints.

    bases : where it stood, by time. places : the same by the readings of its arm, the reference first; empty where that
    is not read.
    tip_from_camera : the camera in the endoscope's tip; ecm_from_base : the arm's base in that of the endoscope's arm.
    std_tip_from_camera, std_ecm_from_base : standard deviations along and about the axes of the tip and of the arm's
    base, with what the offsets of the ECM leave open. expected : the prior mean of the camera in the tip.
    offsets, std_offsets : of the ECM's joints: true = reading + offset.
    covariance : (K + M, K + M) of base and offsets, as in ``covariance.given_camera``, and of the M unknowns of the
    endoscope.
    """

    bases: tuple[Stand, ...] = ()
    places: tuple[Place, ...] = ()
    tip_from_camera: Transform | None = None
    ecm_from_base: Transform | None = None
    std_tip_from_camera: Row = ()
    std_ecm_from_base: Row = ()
    expected: Transform | None = None
    offsets: dict[str, Number] = field(default_factory=dict)
    std_offsets: dict[str, Number] = field(default_factory=dict)
    covariance: Float64 = field(default_factory=lambda: np.zeros((0, 0)), metadata=SIGNIFICANT)

    @classmethod
    def of(cls, arm: ArmSession) -> SessionEndoscope | None:
        """Return what an arm that is solved shows; None of an endoscope that stands still.

        The standard deviations have what errors of the camera and of all masks add to the covariance, too.
        """
        model, calibration, covariance = arm.model, arm.calibration, arm.solution.covariance
        endoscope, values, base = model.endoscope, calibration.endoscope, calibration.camera_from_base
        if endoscope is None or values is None:
            return None
        names, times = [frame.name for frame in arm.frames], [frame.time for frame in arm.frames]
        stands = _stands(model.camera_from_base(calibration), endoscope.place, names, times)
        if not isinstance(endoscope, Steered):
            return cls(stands, covariance=covariance)
        count = calibration.place(ENDOSCOPE).start
        cameras, changes = endoscope.cameras(values)
        jacobian = np.eye(6, len(covariance))  # of the arm's base in the ECM's
        jacobian[:, count:] = adjoint(inverse(base)) @ changes[0]
        whole = covariance + arm.checked.covariance
        std = np.sqrt(np.diag(whole))[count:]
        return cls(
            stands,
            tuple(replace(one, error=_row(error)) for one, error in zip(endoscope.places, values.errors, strict=True)),
            values.tip_from_camera,
            cameras[0] @ base,
            _row(std[:6]),
            _row(np.sqrt(np.diag(jacobian @ whole @ jacobian.T))),
            endoscope.block.expected[0],
            dict(zip(ECM_JOINTS, values.numbers[:4].tolist(), strict=True)),
            dict(zip(ECM_JOINTS, std[6:10].tolist(), strict=True)),
            covariance,
        )

    @classmethod
    def from_document(cls, where: str, document: Any, known: int) -> SessionEndoscope | None:
        """Read the field ``endoscope`` of a document, None where it is null, with K = ``known`` axes of the base."""
        if document is None:
            return None
        where = f"{where}: endoscope"
        if not isinstance(document, Mapping):
            raise refused(where, "", "an object", document)
        matrix = document.get("covariance")
        found = convert_document(where, {name: part for name, part in document.items() if name != "covariance"}, cls)
        if bool(found.places) != (found.tip_from_camera is not None and found.expected is not None):
            raise refused(where, "places", "some with tip_from_camera and expected, else none", len(found.places))
        if any(len(row) != 4 for one in found.places for row in (one.readings, one.within, one.error)):
            raise refused(where, "places", "four numbers of each of readings, within and error", "another number")
        if found.places and tuple(found.offsets) != ECM_JOINTS:
            raise refused(where, "offsets", f"those of {', '.join(ECM_JOINTS)}", found.offsets)
        count = known + (10 + 4 * len(found.places) - 4 if found.places else 6 * found.last_place)
        covariance = read_variances(where, "covariance", matrix, count)
        if not found.places and {one.place for one in found.bases} != set(range(found.last_place + 1)):
            raise refused(where, "bases", "each place from 0 on", [one.place for one in found.bases])
        return replace(found, covariance=covariance)

    @property
    def last_place(self) -> int:
        """Largest number of a place."""
        return max((one.place for one in self.bases), default=0)

    @property
    def undetermined(self) -> list[str]:
        """Descriptions of what the motions do not determine."""
        texts = []
        std = np.array(self.std_tip_from_camera)
        if len(std) and std[3:].max() > UNDETERMINED_ROTATION:
            axis = "xyz"[int(std[3:].argmax())]
            texts.append(
                f"camera in the endoscope's tip: rotation about its {axis} axis known to "
                f"{np.degrees(std[3:].max()):.0f} deg only; moves about different axes would determine it"
            )
        found = [self.std_offsets.get(name, 0.0) for name in ECM_JOINTS]
        pairs = zip(ECM_JOINTS, found, OFFSET_STD.tolist(), strict=True)
        open_ones = [name for name, own, before in pairs if own > _BEFORE * before]
        if self.places and open_ones:
            texts.append(
                f"offsets of {', '.join(open_ones)}: as wide as expected beforehand; those of yaw, insertion and roll "
                "cannot be distinguished from other places of arm and camera"
            )
        return texts

    def in_frames(
        self, camera_from_base: Float64, read: Float64 | None, times: Sequence[float | None], names: Sequence[str]
    ) -> Endoscope | str:
        """Return the endoscope in N frames, with its unknowns as values of the start, or why it is not known in one.

        Parameters
        ----------
        camera_from_base : (4, 4)
            The base in the reference camera, m.
        read : (N, 4)
            Readings of the ECM, NaN without one; None where there are none.
        times, names
            Times, s, and names of the frames, by which the place of an endoscope that is not read is found.
        """
        if self.places:
            if read is None or np.isnan(read).all(axis=0).any():
                return f"no reading of {', '.join(ECM_JOINTS)}"
            assert self.tip_from_camera is not None
            assert self.expected is not None
            errors = [one.error for one in self.places[1:]]
            numbers = np.concatenate([[self.offsets[name] for name in ECM_JOINTS], *errors])
            block = EndoscopeBlock.read(self.expected, len(self.places))
            return Steered(
                block, EndoscopeValues(self.tip_from_camera[None], numbers), block.std, filled(read), self.places
            )
        of_place = {one.place: one.camera_from_base for one in self.bases}
        moves = [of_place[k] @ inverse(camera_from_base) for k in range(1, self.last_place + 1)]
        piece = [self.place_at(time, name) for time, name in zip(times, names, strict=True)]
        return Pieces.of(np.array(piece, np.intp), np.array(moves).reshape(-1, 4, 4))

    def place_at(self, time: float | None, name: str) -> int:
        """Return the place of the piece nearest to a time, s, or where no times are known, to a frame's name."""
        if time is not None and all(one.start is not None and one.end is not None for one in self.bases):
            gaps = [max((one.start or 0.0) - time, time - (one.end or 0.0), 0.0) for one in self.bases]
            return self.bases[int(np.argmin(gaps))].place
        before = [one for one in self.bases if natural(one.first) <= natural(name)]
        return (before[-1] if before else self.bases[0]).place

    def in_words(self) -> list[str]:
        """Describe the places, and the camera in the tip with its standard deviations, a line each."""
        count = self.last_place + 1
        if self.tip_from_camera is None:
            return [f"endoscope: it moved, and is not read: {count} places, each with a base of its own"]
        std = np.array(self.std_tip_from_camera)
        turn = np.degrees(log_rotation((inverse(STRAIGHT) @ self.tip_from_camera)[:3, :3]))
        offsets = ", ".join(
            f"{name.removeprefix('ecm_')} {scale * value:+.2f} {unit} (std {scale * self.std_offsets[name]:.2f})"
            for name, value in self.offsets.items()
            for scale, unit in [(1e3, "mm") if name == "ecm_insertion" else (180 / np.pi, "deg")]
        )
        return [
            f"endoscope: its arm was read at {count} places where it stood",
            f"  camera in its tip: {_numbers(1e3 * self.tip_from_camera[:3, 3])} mm, std {_numbers(1e3 * std[:3])}; "
            f"turned by {_numbers(turn)} deg against a straight one, std {_numbers(np.degrees(std[3:]))}",
            f"  offsets of its joints: {offsets}",
        ]


def _stands(cameras: Float64, place: Indices, names: Sequence[str], times: Sequence[float | None]) -> tuple[Stand, ...]:
    """Return where an endoscope stood, given bases (N, 4, 4), numbers (N,) of places, names and times of frames."""
    ends = [*(np.flatnonzero(np.diff(place)) + 1).tolist(), len(place)]
    stands, first = list[Stand](), 0
    for end in ends:
        if place[first] >= 0:
            own = times[first], times[end - 1]
            stands.append(Stand(int(place[first]), names[first], names[end - 1], cameras[first], *own))
        first = end
    return tuple(stands)


def _numbers(values: Float64) -> str:
    """Format three numbers."""
    return " ".join(f"{value:.1f}" for value in values)


def _row(values: Float64) -> Row:
    """Return values as plain numbers."""
    return tuple(np.asarray(values, np.float64).tolist())
