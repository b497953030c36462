"""For tests of programs that use this one: that a pose is still what it was.

    from dvrk_cmaes.testing import assert_pose_close, read_golden

    golden = read_golden("session/golden.json").frames["0001"]
    assert_pose_close(result, golden, instrument=body.instrument, tip_mm=1.0)

``dvrk-cmaes golden record`` writes such a golden.json, and ``golden check`` does the same for all frames of a session.
"""

from __future__ import annotations

from pathlib import Path

from dvrk_cmaes.evaluate.pose_check import check_pose, table
from dvrk_cmaes.evaluate.pose_error import Tolerance
from dvrk_cmaes.frames.truth import FrameTruth, SessionTruth, read_golden
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.results.result import Result

__all__ = ["FrameTruth", "SessionTruth", "assert_pose_close", "read_golden"]

_USUAL = Tolerance()


def assert_pose_close(
    result: Result,
    golden: FrameTruth | Result,
    *,
    instrument: Instrument | str | Path,
    root_mm: float = _USUAL.root_mm,
    tip_mm: float = _USUAL.tip_mm,
    shaft_deg: float = _USUAL.shaft_deg,
    roll_deg: float = _USUAL.roll_deg,
    pitch_yaw_deg: float = _USUAL.pitch_yaw_deg,
    jaw_deg: float = _USUAL.jaw_deg,
    modulo_twin: bool = False,
) -> None:
    """Assert that a result's pose and joints are those expected, within tolerances.

    Parameters
    ----------
    result
        What was found.
    golden
        What is expected: a frame of a golden.json, or an earlier result.
    instrument
        The instrument, or as `load_instrument` takes it: a bundled one's name, or the path of a URDF.
    root_mm, tip_mm
        Largest distances, mm, of the root's origin, and of the jaw tips (mean of both; not looked at without jaws).
    shaft_deg, roll_deg
        Largest angles, degrees, between the shafts' directions, and of the turn about the shaft.
    pitch_yaw_deg, jaw_deg
        Largest differences, degrees, of the jaw and of all other joints.
    modulo_twin
        Take the mirror twin of the golden pose (roll half a turn further, wrist pitch and yaw negated) as right, too.

    Raises
    ------
    AssertionError
        With a table of what was found, what was expected, the error and what was allowed.
    ValueError
        The golden pose is a result without a pose.
    """
    __tracebackhide__ = True  # pytest then shows the test, not this function
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
