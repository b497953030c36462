"""Assertion for test suites: a result's pose and joints agree with a known pose.

    from dvrk_cmaes.testing import assert_pose_close, read_golden

    golden = read_golden("session/golden.json").frames["0001"]
    assert_pose_close(result, golden, instrument=body.instrument, tip_mm=1.0)

``dvrk-cmaes golden record`` writes such a golden.json. ``dvrk-cmaes golden check`` makes the same comparison for all
frames of a session.
"""

from __future__ import annotations

from pathlib import Path

from dvrk_cmaes.evaluate import Tolerance
from dvrk_cmaes.evaluate.pose_check import check_pose, table
from dvrk_cmaes.frames.truth import FrameTruth, SessionTruth, read_golden
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.results.result import Result

__all__ = ["FrameTruth", "SessionTruth", "assert_pose_close", "read_golden"]

_DEFAULT = Tolerance()


def assert_pose_close(
    result: Result,
    golden: FrameTruth | Result,
    *,
    instrument: Instrument | str | Path,
    root_mm: float = _DEFAULT.root_mm,
    tip_mm: float = _DEFAULT.tip_mm,
    shaft_deg: float = _DEFAULT.shaft_deg,
    roll_deg: float = _DEFAULT.roll_deg,
    pitch_yaw_deg: float = _DEFAULT.pitch_yaw_deg,
    jaw_deg: float = _DEFAULT.jaw_deg,
    modulo_twin: bool = False,
) -> None:
    """Assert that a result's pose and joints agree with the expected ones within tolerances.

    Parameters
    ----------
    result
        The estimated result.
    golden
        The expected pose: a frame of a golden.json, or an earlier result.
    instrument
        The instrument, or the name of a bundled one or the path of a URDF, as for `load_instrument`.
    root_mm, tip_mm
        Largest distances, mm, of the root's origin and of the jaw tips (mean of both; not compared without jaws).
    shaft_deg, roll_deg
        Largest angles, degrees, between the shaft directions and of the rotation about the shaft.
    pitch_yaw_deg, jaw_deg
        Largest differences, degrees, of all joints except the jaw, and of the jaw.
    modulo_twin
        Accept the mirror twin of the golden pose as well.

    Raises
    ------
    AssertionError
        The pose does not agree; the message is a table of found and expected values, errors and tolerances.
    ValueError
        ``golden`` is a result without a pose.
    """
    __tracebackhide__ = True  # pytest hides this function in the traceback
    if isinstance(golden, Result):
        if golden.camera_from_root is None:
            raise ValueError(f"golden: expected a pose, got frame {golden.frame}, which {golden.status}")
        golden = FrameTruth(golden.camera_from_root, golden.joints)
    if not isinstance(instrument, Instrument):
        instrument = load_instrument(instrument)
    tolerance = Tolerance(
        root_mm=root_mm,
        tip_mm=tip_mm,
        shaft_deg=shaft_deg,
        roll_deg=roll_deg,
        pitch_yaw_deg=pitch_yaw_deg,
        jaw_deg=jaw_deg,
    )
    check = check_pose(result, golden, instrument, tolerance, modulo_twin=modulo_twin)
    if not check.right:
        name = f"frame {result.frame}" if result.frame else "the pose"
        raise AssertionError("\n".join((f"{name} is not as expected", *table(check))))
