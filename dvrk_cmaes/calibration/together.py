"""The arms of one session: solved in one problem, in which what they share stands once, and compared with each other.

Shared are an endoscope that moves, the lag, the margins of the masks and, where it is estimated, the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Final, Generic, TypeVar

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.session_loop import solve_session
from dvrk_cmaes.calibration.session_problem import ArmSession
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, adjoint, change_between, inverse, log_rotation
from dvrk_cmaes.instrument.setup_joints import SETUP
from dvrk_cmaes.io.encode import SIGNIFICANT, Document, encoded_fields, rounded_array
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.silhouette.threads import single_blas_thread

R = TypeVar("R", covariant=True)
T = TypeVar("T")

_SETUP_STD: Final = np.array([0.025] * 3 + [np.deg2rad(3.0)] * 3)  # of a base by set-up joints in another, m, rad
_SETUP_LIMIT: Final = 4.0  # standard deviations


Outcome = ArmSession | Exception
"""An arm that is solved with the others, or why it cannot be."""


@dataclass(frozen=True, eq=False)
class Begun(Generic[R]):
    """An arm whose frames are estimated by themselves, and what finishes it once all arms are solved together.

    ``finish`` takes what has become of the ``arm``, None where it has none, and returns the arm's result.
    """

    finish: Callable[[Outcome | None], R]
    arm: ArmSession | None = None

    @staticmethod
    def of(result: T) -> Begun[T]:
        """Return an arm that has its result already."""
        return Begun(lambda _: result)

    def then(self, more: Callable[[R], T]) -> Begun[T]:
        """Return the arm with something that is done with its result."""
        return Begun(lambda outcome: more(self.finish(outcome)), self.arm)

    def within(self, opened: ExitStack) -> Begun[R]:
        """Return the arm with contexts that are left once it is finished."""

        def finish(outcome: Outcome | None) -> R:
            with opened:
                return self.finish(outcome)

        return Begun(finish, self.arm)


def solved_together(arms: Mapping[str, Callable[[], Begun[T]]]) -> dict[str, T]:
    """Begin all arms of a session, solve them in one problem, and finish each; the results by name.

    If an arm cannot be begun or solved, the others are solved and finished, each by itself if one cannot be solved, and
    its error is raised.
    """
    begun: dict[str, Begun[T]] = {}
    results, errors = dict[str, T](), list[Exception]()
    for name, begin in arms.items():
        try:
            begun[name] = begin()
        except Exception as error:
            errors.append(error)
            break
    outcomes = _outcomes({name: arm.arm for name, arm in begun.items() if arm.arm is not None})
    for name, arm in begun.items():
        try:
            results[name] = arm.finish(outcomes.get(name))
        except Exception as error:
            errors.append(error)
    if errors:
        raise errors[0]
    return results


def solved_alone(begun: Begun[T]) -> T:
    """Return the result of an arm that is the only one."""
    return solved_together({"": lambda: begun})[""]


def _outcomes(arms: Mapping[str, ArmSession]) -> dict[str, Outcome]:
    """Solve arms in one problem; each by itself, if that is not possible."""
    try:
        with single_blas_thread():
            return dict(zip(arms, solve_session(list(arms.values())), strict=True)) if arms else {}
    except Exception as error:
        if len(arms) == 1 or not isinstance(error, InputError):
            return dict.fromkeys(arms, error)
    return {name: _outcomes({name: arm})[name] for name, arm in arms.items()}


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
    """Return what arms.json has: the bases relative to the first arm's, and what all show of an endoscope that is read.

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
