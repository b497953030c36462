"""`dvrk-cmaes export`: which camera_from_base is taken, what is said of it, and what is written where."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from canned_results import BASE, canned, failed, write_results
from commands import Ran, run_command

from dvrk_cmaes.export.base_choice import median_pose
from dvrk_cmaes.export.formats import DIRECTIONS
from dvrk_cmaes.geometry import moved, rotation_angle
from dvrk_cmaes.io.atomic import write_json

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
    """Make three frames that agree, two whose base is far off but doubtful or failed."""
    wrong = canned("0003", 3, status="doubtful", reasons=("tiny",), camera_from_base=OTHER)
    return write_results(tmp_path / "out", *(canned(f"000{k}", k) for k in range(3)), wrong, failed("0004"))


@pytest.mark.parametrize("to", sorted(DIRECTIONS))
def test_every_format_is_written_beside_the_results_and_named(to: str, results: Path, run: Run) -> None:
    ran = run(results, "--to", to, "--json", *(["--out", results / "exports"] if to == "tf" else []))
    assert ran.code == 0
    assert ran.result["direction"] == DIRECTIONS[to]  # type: ignore[index]
    assert ran.result["written"]
    for path in map(Path, ran.result["written"]):
        assert path.stat().st_size > 0
        assert (results / "exports") in path.parents
    assert len(ran.result["written"]) == sum(path.is_file() for path in (results / "exports").rglob("*"))


def test_a_session_calibration_wins_over_its_frames(results: Path, run: Run) -> None:
    write_json(results / "session.json", session())
    ran = run(results, "--to", "dvrk", "--json")
    np.testing.assert_allclose(exported_base(ran), OTHER, atol=1e-8)
    assert ran.result["base"]["origin"] == f"the session calibration {results / 'session.json'} of 2 frames"


def test_a_session_calibration_alone_will_do(tmp_path: Path, run: Run) -> None:
    write_json(tmp_path / "session.json", session())
    for source in (tmp_path, tmp_path / "session.json"):
        np.testing.assert_allclose(exported_base(run(source, "--to", "tf", "--json")), OTHER, atol=1e-8)
    ran = run(tmp_path, "--to", "bop")
    assert ran.code == 2
    assert ran.err == f"dvrk-cmaes: {tmp_path}: expected results of frames, got a session calibration only\n"


def test_a_frame_that_is_named_wins_over_the_session(results: Path, run: Run) -> None:
    write_json(results / "session.json", session())
    ran = run(results, "--to", "dvrk", "--frame", "0001", "--json")
    np.testing.assert_allclose(exported_base(ran), BASE, atol=1e-8)
    assert ran.result["base"]["frames"] == ["0001"]


def test_frames_give_the_median_of_those_that_are_ok(results: Path, run: Run) -> None:
    ran = run(results, "--to", "dvrk", "--json")
    np.testing.assert_allclose(exported_base(ran), BASE, atol=1e-6)
    assert ran.result["base"]["frames"] == ["0000", "0001", "0002"]
    assert ran.result["base"]["origin"] == (
        "the median of 3 of 5 frames, from their readings of the outer joints as they are; "
        "half of them lie within 0.0 mm and 0.0 deg of it"
    )


def test_with_too_few_ok_frames_the_doubtful_ones_count_as_well_and_that_is_said(tmp_path: Path, run: Run) -> None:
    doubtful = [canned(f"000{k}", k, status="doubtful", reasons=("tiny",)) for k in range(2)]
    out = write_results(tmp_path, canned("0004"), *doubtful, canned("0005", camera_from_base=None), failed("0006"))
    ran = run(out, "--to", "dvrk", "--json")
    assert ran.result["base"]["frames"] == ["0000", "0001", "0004"]
    assert ran.err == ("dvrk-cmaes: warning: too few frames are ok (1 of 5): doubtful ones are used as well\n")


def test_frames_that_disagree_are_exported_with_a_warning(tmp_path: Path, run: Run) -> None:
    turned = [canned(f"000{k}", camera_from_base=moved(BASE, [0, 0, 0, 0, 0, 0.3 * k])) for k in range(4)]
    ran = run(write_results(tmp_path, *turned), "--to", "dvrk", "--json")
    assert ran.result["base"]["spread_deg"] > 5
    assert "the frames disagree: calibrate the session" in ran.err


def test_one_doubtful_frame_is_exported_with_its_reasons(results: Path, run: Run) -> None:
    ran = run(results / "frames" / "0003.json", "--to", "dvrk", "--json")
    np.testing.assert_allclose(exported_base(ran), OTHER, atol=1e-8)
    assert ran.err == "dvrk-cmaes: warning: frame 0003 is doubtful: tiny\n"


def test_one_result_of_a_batch_is_exported_beside_its_folder_of_frames(results: Path, run: Run) -> None:
    ran = run(results / "frames" / "0001.json", "--to", "csv", "--json")
    assert ran.result["written"] == [str(results / "exports" / "poses.csv")]


def test_the_tf_line_alone_goes_to_stdout(results: Path, run: Run) -> None:
    ran = run(results, "--to", "tf", "--arm", "PSM3")
    (line,) = ran.out.splitlines()
    assert line.startswith("ros2 run tf2_ros static_transform_publisher --x 0.0")
    assert line.endswith("--frame-id camera --child-frame-id PSM3_base")
    assert ran.err.startswith("dvrk-cmaes: camera_from_base: the median of 3 of 5 frames, ")
    assert not (results / "exports").exists()


def test_frames_without_a_pose_are_left_out_and_counted(results: Path, run: Run) -> None:
    ran = run(results, "--to", "tracker", "--json")
    assert ran.result["left_out"] == ["0004"]
    assert ran.err == "dvrk-cmaes: warning: no pose, left out (1): 0004\n"
    assert len(ran.result["written"]) == 8


def test_without_any_base_it_is_refused(tmp_path: Path, run: Run) -> None:
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


def test_wrong_input_is_named(results: Path, run: Run) -> None:
    assert run(results, "--to", "csv", "--frame", "0009").refusal.startswith(
        f"{results}: frame: expected one of 5 frames (0000"
    )
    single = results / "frames" / "0001.json"
    assert run(single, "--to", "csv", "--frame", "0002").refusal == f"{single}: frame: expected '0002', got '0001'"
    assert run(results / "x", "--to", "csv").refusal.startswith(f"{results / 'x'}: no such file; expected")
    assert run(results, "--to", "bop", "--scene", "-1").refusal.startswith("--scene, --object-id: expected")
    write_json(results / "session.json", {"camera_from_base": [[1, 2]]})
    assert run(results, "--to", "dvrk").refusal == (
        f"{results / 'session.json'}: camera_from_base: expected 4 rows of 4 finite numbers, got [[1, 2]]"
    )


def test_a_result_cannot_lead_out_of_the_folder(tmp_path: Path, run: Run) -> None:
    path = tmp_path / "a.json"
    write_json(path, canned("../../evil").to_dict())
    assert run(path, "--to", "tracker", "--out", tmp_path / "x").refusal == (
        "frame: expected a name that can be a file's (no slash, no leading dot), got '../../evil'"
    )


def test_the_median_pose_bears_a_third_of_nonsense() -> None:
    rng = np.random.default_rng(0)
    near = [moved(BASE, [*rng.normal(0, 1e-3, 3), *rng.normal(0, 0.01, 3)]) for _ in range(20)]
    far = [moved(BASE, [*rng.normal(0, 0.3, 3), *rng.normal(0, 2.0, 3)]) for _ in range(10)]
    found = median_pose(np.array([*near, *far]))
    assert np.linalg.norm(found[:3, 3] - BASE[:3, 3]) < 1e-3
    assert np.degrees(rotation_angle(found, BASE)) < 0.6
