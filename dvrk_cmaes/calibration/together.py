"""The arms of one session in one solution: what the frames of all of them tell of what they share.

Of one least-squares problem over the frames of all arms, the unknowns of the other arms alone, bases and offsets, are
eliminated: what is left of their frames is what they tell of the unknowns that are shared, which an arm takes into its
own solution. Shared are the endoscope, the lag, the margins of the masks and, where it is estimated, the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any, Final, Generic, TypeVar

import numpy as np

from dvrk_cmaes.calibration.alternation import fitted_again
from dvrk_cmaes.calibration.blocks import ENDOSCOPE
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import Place, Steered
from dvrk_cmaes.calibration.session_state import SessionState
from dvrk_cmaes.geometry import Float64, adjoint, change_between, inverse, log_rotation
from dvrk_cmaes.instrument.setup_joints import SETUP
from dvrk_cmaes.io.encode import SIGNIFICANT, Document, encoded_fields
from dvrk_cmaes.io.rounding import rounded_array
from dvrk_cmaes.joints.names import ECM_JOINTS

R = TypeVar("R", covariant=True)
T = TypeVar("T")

_AGREE: Final = 4.0  # standard deviations of each unknown, within which arms tell the same
_LEAST_PX: Final = 0.05  # change of the camera and of margins, from which on frames are fitted again
_SETUP_STD: Final = np.array([0.025] * 3 + [np.deg2rad(3.0)] * 3)  # of a base by set-up joints in another, m, rad
_SETUP_LIMIT: Final = 4.0  # standard deviations
_HAND_EYE: Final = 10  # unknowns that do not differ from place to place


@dataclass(frozen=True, eq=False)
class Begun(Generic[R]):
    """An arm's session that is solved by itself, and what finishes it once those of the other arms are, too.

    ``finish`` takes the states of the other arms, and returns the arm's result. ``state`` is that of the arm; None
    where it has none that tells others of anything.
    """

    finish: Callable[[Sequence[SessionState]], R]
    state: SessionState | None = None

    @staticmethod
    def of(result: T) -> Begun[T]:
        """Return an arm that has its result already."""
        return Begun(lambda _: result)

    def then(self, more: Callable[[R], T]) -> Begun[T]:
        """Return the arm with something that is done with its result."""
        return Begun(lambda others: more(self.finish(others)), self.state)

    def within(self, opened: ExitStack) -> Begun[R]:
        """Return the arm with contexts that are left once it is finished."""

        def finish(others: Sequence[SessionState]) -> R:
            with opened:
                return self.finish(others)

        return Begun(finish, self.state)


def solved_together(arms: Mapping[str, Callable[[Sequence[Place]], Begun[T]]]) -> dict[str, T]:
    """Solve all arms of a session, each with what the frames of the others tell; the results by name.

    Each arm is begun, given the places at which an arm before it found the endoscope, and then each is finished. If an
    arm cannot be begun, those before it are finished by themselves, and its error is raised.
    """
    begun: dict[str, Begun[T]] = {}
    failed: Exception | None = None
    places: Sequence[Place] = ()
    for name, begin in arms.items():
        try:
            begun[name] = begin(places)
        except Exception as error:
            failed = error
            break
        state = begun[name].state
        endoscope = None if state is None else state.model.endoscope
        places = places or (endoscope.places if isinstance(endoscope, Steered) else ())
    states = {} if failed else {name: arm.state for name, arm in begun.items() if arm.state is not None}
    results = {
        name: arm.finish([state for other, state in states.items() if other != name]) for name, arm in begun.items()
    }
    if failed is not None:
        raise failed
    return results


def solved_alone(begun: Begun[T]) -> T:
    """Return the result of an arm that is the only one."""
    return begun.finish(())


def with_others(state: SessionState, others: Sequence[SessionState]) -> SessionState:
    """Return an arm's session solved with what the frames of the other arms tell, which are solved by themselves."""
    if not others:
        return state
    camera = state.stored[0].camera
    imaging = state.imaging.with_others([other.imaging for other in others if other.stored[0].camera == camera])
    told = replace(_with_endoscope(state, others), imaging=imaging)
    told = replace(told, lag=told.lag.with_others([other.lag for other in others]))
    if told.model is state.model and told.lag is state.lag and not _differs(told, state):
        return told
    again = range(len(state.frames)) if _differs(told, state) else ()
    return fitted_again(replace(told, model=told.lag.corrected(told.model)), again)


def _with_endoscope(state: SessionState, others: Sequence[SessionState]) -> SessionState:
    """Return an arm's session that knows beforehand what the others tell of the endoscope.

    Of one that is not read, these are the moves of the camera between pieces, where the others have the same pieces.
    """
    own, read = state.solution.calibration.endoscope, isinstance(state.model.endoscope, Steered)
    if own is None:
        return state
    endoscope = state.model.endoscope
    assert endoscope is not None
    prior = information = endoscope.block.information
    vector = np.zeros(len(prior))
    mine, of_mine = own.deviation, _of_endoscope(state)
    for other in others:
        values = other.solution.calibration.endoscope
        if values is None or (len(values.poses), len(values.numbers)) != (len(own.poses), len(own.numbers)):
            continue
        theirs, of_theirs = replace(values, expected=own.expected).deviation, _of_endoscope(other)
        compared = _HAND_EYE if read else len(mine)
        apart = np.abs(mine - theirs) > _AGREE * np.sqrt(np.diag(of_mine + of_theirs))
        if apart[:compared].any() and not read:
            continue
        if apart[:compared].any():
            text = (
                "the arms tell another camera in the endoscope's tip: each has its own; one arm's readings may be wrong"
            )
            return state.noted(remarks=[text])
        inverted = np.linalg.inv(of_theirs)
        values_told, axes = np.linalg.eigh(inverted - prior)  # what is known beforehand counts once
        information = information + (axes * np.maximum(values_told, 0.0)) @ axes.T
        vector = vector + inverted @ theirs
    if information is prior:
        return state
    known = replace(own, mean=np.asarray(np.linalg.solve(information, vector), np.float64))
    model = replace(state.model, endoscope=endoscope.with_prior(information))
    calibration = state.solution.calibration.beside(endoscope.with_prior(information).block, endoscope=known)
    return replace(
        state,
        model=model,
        found=replace(state.solution, calibration=calibration),
    )


def _of_endoscope(state: SessionState) -> Float64:
    """Return the covariance (M, M) of the endoscope's values that the frames of an arm tell."""
    solution = state.solution
    place = solution.calibration.place(ENDOSCOPE)
    return solution.covariance[place, place]


def _differs(one: SessionState, other: SessionState) -> bool:
    """Whether two states of a session see its frames by another camera, or with other margins taken off the masks."""
    pairs = zip(one.imaging.margins, other.imaging.margins, strict=True)
    moved = [abs(a.px * a.applied - b.px * b.applied) for (_, a), (_, b) in pairs]
    if one.imaging.change is not None and other.imaging.change is not None:
        width = one.stored[0].camera.width
        moved.append(float(np.abs((one.imaging.change - other.imaging.change) * [width / 2, 1.0, 1.0]).max()))
    return max(moved, default=0.0) > _LEAST_PX


@dataclass(frozen=True, eq=False)
class RelativeBase(Document):
    """Pose of an arm's base in the base of a reference arm.

    ``reference_from_base`` is (4, 4), m; ``covariance`` (6, 6) that of its small changes [t, r] in the arm's own base's
    axes, m and rad.
    """

    reference_from_base: Float64 = field(metadata=SIGNIFICANT)
    covariance: Float64 = field(metadata=SIGNIFICANT)

    @classmethod
    def between(cls, reference: SessionCalibration, other: SessionCalibration, shared: Float64) -> RelativeBase:
        """Compute the pose of an arm's base in a reference arm's from the calibrations of both with one camera.

        ``shared`` (6, 6) is the covariance of both bases, the reference's first, by the endoscope. Errors of the
        camera's file have the same direction in both, so that the true covariance is rather smaller.
        """
        reference_from_base = inverse(reference.camera_from_base) @ other.camera_from_base
        of_reference = adjoint(inverse(reference_from_base))
        both = of_reference @ shared
        covariance = other.covariance[:6, :6] + of_reference @ reference.covariance[:6, :6] @ of_reference.T
        return cls(np.asarray(reference_from_base), np.asarray(covariance - both - both.T))

    def describe(self) -> str:
        """Describe distance and angle in words, with standard deviations."""
        away, std = self.reference_from_base[:3, 3], np.sqrt(np.diag(self.covariance))
        angle = np.linalg.norm(log_rotation(self.reference_from_base[:3, :3]))
        return (
            f"{1e3 * np.linalg.norm(away):.1f} mm away, turned by {np.degrees(angle):.2f} deg (std per axis "
            f"{1e3 * std[:3].mean():.1f} mm, {np.degrees(std[3:].mean()):.2f} deg)"
        )


def relative_bases(calibrations: Mapping[str, SessionCalibration]) -> dict[str, RelativeBase]:
    """Return the bases of all arms but the first, by name, in the base of the first.

    Where the endoscope moved, they are compared at one of its places; an arm whose base is not known there is left out.
    """
    reference, *others = calibrations
    moves = calibrations[reference].endoscope
    where: dict[str, Any] = {}
    if moves is not None and moves.bases:
        stand = next((one for one in moves.bases if one.place == 0), moves.bases[0])
        where = {"frame": stand.first, "time": stand.start}
    readings = {} if moves is None or not moves.places else dict(zip(ECM_JOINTS, moves.places[0].readings, strict=True))
    placed = {arm: own.at(readings, **where) for arm, own in calibrations.items()}
    still = {arm: own for arm, own in placed.items() if isinstance(own, SessionCalibration)}
    return {
        arm: RelativeBase.between(still[reference], still[arm], _of_both(calibrations[reference], calibrations[arm]))
        for arm in others
        if {reference, arm} <= set(still)
    }


def _of_both(one: SessionCalibration, other: SessionCalibration) -> Float64:
    """Return the covariance (6, 6) of the bases of two arms by the endoscope that both were solved with, where read."""
    if any(own.endoscope is None or not own.endoscope.places for own in (one, other)):
        return np.zeros((6, 6))
    first, second, own, their = one.whole_covariance, other.whole_covariance, len(one.axes), len(other.axes)
    if len(first) - own != len(second) - their:
        return np.zeros((6, 6))
    return np.asarray(first[:6, own:] @ np.linalg.solve(first[own:, own:], second[their:, :6]))


@dataclass(frozen=True)
class SetupJoints(Document):
    """How far an arm's base in that of the first arm is from where the set-up joints say it is.

    off_mm, off_deg : distance and angle. agrees : whether these are within what is expected of both.
    """

    off_mm: float
    off_deg: float
    agrees: bool

    def describe(self, arm: str, reference: str) -> str:
        """Describe a disagreement in words."""
        return (
            f"base of {arm} from that of {reference}: {self.off_mm:.0f} mm and {self.off_deg:.0f} deg from where "
            f"{SETUP} has it: exchanged arms, readings or set-up joints of another time, or a wrong calibration"
        )


def against_setup(
    bases: Mapping[str, RelativeBase], reference: str, setup: Mapping[str, Float64]
) -> dict[str, SetupJoints]:
    """Compare the bases of arms in that of the reference arm with the set-up joints', where these have both arms.

    ``setup`` are the poses (4, 4) of the arms' bases in one frame, m, by name.
    """
    found = {}
    for arm in (arm for arm in bases if {arm, reference} <= setup.keys()):
        off = change_between(bases[arm].reference_from_base, inverse(setup[reference]) @ setup[arm])
        expected = np.hypot(np.sqrt(np.diag(bases[arm].covariance)), _SETUP_STD)
        off_mm, off_deg = 1e3 * float(np.linalg.norm(off[:3])), float(np.degrees(np.linalg.norm(off[3:])))
        found[arm] = SetupJoints(off_mm, off_deg, bool((np.abs(off) < _SETUP_LIMIT * expected).all()))
    return found


def arms_document(
    calibrations: Mapping[str, SessionCalibration], bases: Mapping[str, RelativeBase], setup: Mapping[str, SetupJoints]
) -> dict[str, Any]:
    """Return what arms.json has: the bases relative to the first arm's, and what all tell of an endoscope that is read.

    ``bases`` are of `relative_bases`, ``setup`` of `against_setup`.
    """
    reference = next(iter(calibrations))
    arms_bases = {
        arm: {**base.to_dict(), "setup_joints": setup[arm].to_dict() if arm in setup else None}
        for arm, base in bases.items()
    }
    document: dict[str, Any] = {"reference": reference, "arms": arms_bases}
    moves = {arm: own.endoscope for arm, own in calibrations.items() if own.endoscope is not None}
    read = {arm: own for arm, own in moves.items() if own.places}
    if len(read) < len(calibrations):
        return {**document, "endoscope": None}
    arms = {
        arm: {"ecm_from_base": rounded_array(own.ecm_from_base), "std": rounded_array(np.array(own.std_ecm_from_base))}
        for arm, own in read.items()
        if own.ecm_from_base is not None
    }
    shared = encoded_fields(read[reference], "tip_from_camera", "std_tip_from_camera", "offsets", "std_offsets")
    return {**document, "endoscope": {**shared, "arms": arms}}
