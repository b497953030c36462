"""``assert_pose_close``: passes within tolerance, and otherwise fails with a table of the deviations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.canned_results import canned, failed
from helpers.transforms import moved

from dvrk_cmaes import Body, Instrument, Result
from dvrk_cmaes.frames.truth import FrameTruth
from dvrk_cmaes.testing import assert_pose_close

pytest_plugins = ["pytester"]

GOLDEN = canned("0026")
assert GOLDEN.camera_from_root is not None
TRUTH = FrameTruth(GOLDEN.camera_from_root, GOLDEN.joints)


def moved_by(*change: float, **joints: float) -> Result:
    """Move the golden pose by m and rad in the root's axes, and set some joints."""
    return replace(GOLDEN, camera_from_root=moved(TRUTH.camera_from_root, change), joints={**GOLDEN.joints, **joints})


def twin_of(result: Result, instrument: Instrument) -> Result:
    pose, joints = instrument.twin(result.camera_from_root, list(result.joints.values()))
    return replace(result, camera_from_root=pose, joints=dict(zip(result.joints, joints.tolist(), strict=True)))


@pytest.fixture
def instrument(bundled_body: Body) -> Instrument:
    return bundled_body.instrument


def complaint(result: Result, instrument: Instrument, **options: float) -> str:
    with pytest.raises(AssertionError) as caught:
        assert_pose_close(result, TRUTH, instrument=instrument, **options)  # type: ignore[arg-type]
    return str(caught.value)


def test_pose_within_tolerance_passes(instrument: Instrument) -> None:
    result = moved_by(0.0002, 0.0, 0.0003, 0.001, 0.0, 0.02, jaw=0.74)
    assert_pose_close(result, TRUTH, instrument=instrument)
    assert_pose_close(result, GOLDEN, instrument="lnd")


def test_tolerances_are_in_mm_and_deg(instrument: Instrument) -> None:
    assert_pose_close(moved_by(0.0, 0.0, 0.002, 0, 0, 0), TRUTH, instrument=instrument, root_mm=2.1, tip_mm=2.1)
    complaint(moved_by(0.0, 0.0, 0.002, 0, 0, 0), instrument, root_mm=1.9, tip_mm=2.1)
    complaint(moved_by(0.0, 0.0, 0.002, 0, 0, 0), instrument, root_mm=2.1, tip_mm=1.9)
    turned = moved_by(0, 0, 0, 0, 0, np.radians(4.0))
    assert_pose_close(turned, TRUTH, instrument=instrument, roll_deg=4.1, tip_mm=5)
    complaint(turned, instrument, roll_deg=3.9, tip_mm=5)
    tilted = moved_by(0, 0, 0, np.radians(4.0), 0, 0)
    assert_pose_close(tilted, TRUTH, instrument=instrument, shaft_deg=4.1, tip_mm=5)
    complaint(tilted, instrument, shaft_deg=3.9, tip_mm=5)
    bent = moved_by(0, 0, 0, 0, 0, 0, wrist_yaw=-0.2 + np.radians(4.0), jaw=0.7 - np.radians(5.0))
    assert_pose_close(bent, TRUTH, instrument=instrument, pitch_yaw_deg=4.1, jaw_deg=5.1, tip_mm=5)
    complaint(bent, instrument, pitch_yaw_deg=3.9, jaw_deg=5.1, tip_mm=5)
    complaint(bent, instrument, pitch_yaw_deg=4.1, jaw_deg=4.9, tip_mm=5)


def test_message_is_table_of_deviations(instrument: Instrument) -> None:
    heading, columns, *rows = complaint(moved_by(0.003, 0, 0.004, 0, 0, 0, jaw=0.8), instrument).splitlines()
    assert heading == "frame 0026 is not as expected"
    assert columns.split() == ["found", "expected", "error", "at", "most"]
    table = {row.split(",")[0]: row for row in rows}
    assert list(table) == ["root", "tip", "shaft", "roll", "wrist_pitch", "wrist_yaw", "jaw"]
    assert [name for name, row in table.items() if row.endswith("<- off")] == ["root", "tip", "jaw"]
    assert table["root"].split()[-4:] == ["5.00", "0.5", "<-", "off"]
    assert table["jaw"].split() == ["jaw,", "deg", "45.84", "40.11", "5.73", "3", "<-", "off"]


def test_twin_passes_only_on_request(instrument: Instrument) -> None:
    twin = twin_of(GOLDEN, instrument)
    text = complaint(twin, instrument)
    assert text.endswith("the mirror twin of the golden pose would be within tolerance (modulo_twin)")
    assert_pose_close(twin, TRUTH, instrument=instrument, modulo_twin=True)
    assert_pose_close(GOLDEN, TRUTH, instrument=instrument, modulo_twin=True)


def test_golden_result_must_have_pose(instrument: Instrument) -> None:
    with pytest.raises(ValueError, match="golden: expected a pose, got frame 0001, which failed"):
        assert_pose_close(GOLDEN, failed("0001"), instrument=instrument)


def test_traceback_ends_at_callers_line(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        from helpers.canned_results import canned
        from dvrk_cmaes.testing import assert_pose_close

        def test_pose():
            assert_pose_close(canned("1", 1), canned("1", 0), instrument="lnd")
        """
    )
    shown = pytester.runpytest("-p", "no:cacheprovider")
    shown.assert_outcomes(failed=1)
    shown.stdout.fnmatch_lines(["*> *assert_pose_close(*", "*frame 1 is not as expected", "*root, mm*<- off"])
    assert "def assert_pose_close" not in shown.stdout.str()
