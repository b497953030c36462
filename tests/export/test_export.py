"""`dvrk-cmaes export`: choice of camera_from_base, messages and written files."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.canned_results import BASE, canned, failed, write_results
from helpers.commands import Ran, run_command
from helpers.files import write_json
from helpers.transforms import moved, rotation_angle

from dvrk_cmaes.export.base_choice import median_pose

OTHER = moved(BASE, [0.01, 0.02, 0.0, 0.0, 0.0, 0.3])

Run = Callable[..., Ran]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run ``dvrk-cmaes export``."""
    return partial(run_command, capsys, "export")


def exported_base(ran: Ran) -> np.ndarray:
    assert ran.code == 0, ran.err
    return np.array(ran.result["base"]["camera_from_base"])


def session(base: np.ndarray = OTHER) -> dict[str, Any]:
    return {"schema": 1, "camera_from_base": base.tolist(), "frames": ["0000", "0001"]}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Write three frames that agree, a doubtful one with another base and a failed one."""
    wrong = canned("0003", 3, status="doubtful", reasons=("tiny",), camera_from_base=OTHER)
    return write_results(tmp_path / "out", *(canned(f"000{k}", k) for k in range(3)), wrong, failed("0004"))


def test_calibration_is_preferred_to_frames(results: Path, run: Run) -> None:
    write_json(results / "session.json", session())
    ran = run(results, "--to", "dvrk", "--json")
    np.testing.assert_allclose(exported_base(ran), OTHER, atol=1e-8)
    assert ran.result["base"]["origin"] == f"the session calibration {results / 'session.json'} of 2 frames"


def test_median_of_ok_frames_is_exported(results: Path, run: Run) -> None:
    ran = run(results, "--to", "dvrk", "--json")
    np.testing.assert_allclose(exported_base(ran), BASE, atol=1e-6)
    assert ran.result["base"]["frames"] == ["0000", "0001", "0002"]
    assert ran.result["base"]["origin"] == (
        "the median of 3 of 5 frames, from their readings of the outer joints as they are; "
        "half of them lie within 0.0 mm and 0.0 deg of it"
    )


def test_doubtful_frames_are_used_if_too_few_are_ok(tmp_path: Path, run: Run) -> None:
    doubtful = [canned(f"000{k}", k, status="doubtful", reasons=("tiny",)) for k in range(2)]
    out = write_results(tmp_path, canned("0004"), *doubtful, canned("0005", camera_from_base=None), failed("0006"))
    ran = run(out, "--to", "dvrk", "--json")
    assert ran.result["base"]["frames"] == ["0000", "0001", "0004"]
    assert ran.err == ("dvrk-cmaes: warning: too few frames are ok (1 of 5): doubtful ones are used as well\n")


def test_frames_without_pose_are_left_out_with_warning(results: Path, run: Run) -> None:
    ran = run(results, "--to", "bop", "--json")
    assert ran.result["left_out"] == ["0004"]
    assert ran.err == "dvrk-cmaes: warning: no pose, left out (1): 0004\n"
    assert len(ran.result["written"]) == 1


def test_results_without_base_are_refused(tmp_path: Path, run: Run) -> None:
    out = write_results(tmp_path, canned("0001", camera_from_base=None), failed("0002"))
    assert run(out, "--to", "dvrk").refusal == (
        f"{out}: camera_from_base: expected a session calibration (session.json), or frames that were estimated "
        "with yaw, pitch, insertion and roll; got 2 frames without"
    )
    assert run(out, "--to", "tf", "--frame", "0001").refusal == (
        f"{out}: camera_from_base: expected 4 rows of 4 numbers, got none: frame 0001 was estimated without yaw, "
        "pitch, insertion and roll"
    )
    assert run(out, "--to", "tf", "--frame", "0002").refusal.endswith("got none: frame 0002 failed")
    assert not (out / "exports").exists()


@pytest.mark.parametrize("to", ["tracker", "joint-correction"])
def test_format_that_is_no_longer_written_is_refused_with_what_is_used(results: Path, run: Run, to: str) -> None:
    assert run(results, "--to", to).refusal.startswith(f"--to {to}: no option here; use ")
    assert run(results, f"--to={to}").refusal.startswith(f"--to {to}: no option here; use ")


def test_median_pose_tolerates_third_of_outliers() -> None:
    rng = np.random.default_rng(0)
    near = [moved(BASE, [*rng.normal(0, 1e-3, 3), *rng.normal(0, 0.01, 3)]) for _ in range(20)]
    far = [moved(BASE, [*rng.normal(0, 0.3, 3), *rng.normal(0, 2.0, 3)]) for _ in range(10)]
    found = median_pose(np.array([*near, *far]))
    assert np.linalg.norm(found[:3, 3] - BASE[:3, 3]) < 1e-3
    assert np.degrees(rotation_angle(found, BASE)) < 0.6
