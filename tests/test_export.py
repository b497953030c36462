"""`dvrk-cmaes export`: which camera_from_base is taken, what is said of it, and what is written where."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from canned_results import BASE, canned, failed, write_results

from dvrk_cmaes.cli import main
from dvrk_cmaes.export.base_choice import median_pose
from dvrk_cmaes.export.formats import DIRECTIONS
from dvrk_cmaes.geometry import moved, rotation_angle
from dvrk_cmaes.io.atomic import write_json

OTHER = moved(BASE, [0.01, 0.02, 0.0, 0.0, 0.0, 0.3])


class Run:
    """A finished command: its exit code and what it said."""

    def __init__(self, capsys: pytest.CaptureFixture[str], *arguments: object) -> None:
        self.code = main(["export", *map(str, arguments)])
        said = capsys.readouterr()
        self.out, self.error = said.out, said.err

    @property
    def json(self) -> dict[str, Any]:
        parsed: dict[str, Any] = json.loads(self.out)
        return parsed


def exported_base(run: Run) -> np.ndarray:
    assert run.code == 0, run.error
    return np.array(run.json["base"]["camera_from_base"])


def session(base: np.ndarray = OTHER) -> dict[str, Any]:
    return {"schema": 1, "camera_from_base": base.tolist(), "frames": ["0000", "0001"]}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Make three frames that agree, two whose base is far off but doubtful or failed."""
    wrong = canned("0003", 3, status="doubtful", reasons=("tiny",), camera_from_base=OTHER)
    return write_results(tmp_path / "out", *(canned(f"000{k}", k) for k in range(3)), wrong, failed("0004"))


@pytest.mark.parametrize("to", sorted(DIRECTIONS))
def test_every_format_is_written_beside_the_results_and_named(
    to: str, results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Run(capsys, results, "--to", to, "--json", *(["--out", results / "exports"] if to == "tf" else []))
    assert run.code == 0
    assert run.json["direction"] == DIRECTIONS[to]  # type: ignore[index]
    assert run.json["written"]
    for path in map(Path, run.json["written"]):
        assert path.stat().st_size > 0
        assert (results / "exports") in path.parents
    assert len(run.json["written"]) == sum(path.is_file() for path in (results / "exports").rglob("*"))


def test_a_session_calibration_wins_over_its_frames(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_json(results / "session.json", session())
    run = Run(capsys, results, "--to", "dvrk", "--json")
    np.testing.assert_allclose(exported_base(run), OTHER, atol=1e-8)
    assert run.json["base"]["origin"] == f"the session calibration {results / 'session.json'} of 2 frames"


def test_a_session_calibration_alone_will_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_json(tmp_path / "session.json", session())
    for source in (tmp_path, tmp_path / "session.json"):
        np.testing.assert_allclose(exported_base(Run(capsys, source, "--to", "tf", "--json")), OTHER, atol=1e-8)
    run = Run(capsys, tmp_path, "--to", "bop")
    assert run.code == 2
    assert run.error == f"dvrk-cmaes: {tmp_path}: expected results of frames, got a session calibration only\n"


def test_a_frame_that_is_named_wins_over_the_session(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_json(results / "session.json", session())
    run = Run(capsys, results, "--to", "dvrk", "--frame", "0001", "--json")
    np.testing.assert_allclose(exported_base(run), BASE, atol=1e-8)
    assert run.json["base"]["frames"] == ["0001"]


def test_frames_give_the_median_of_those_that_are_ok(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = Run(capsys, results, "--to", "dvrk", "--json")
    np.testing.assert_allclose(exported_base(run), BASE, atol=1e-6)
    assert run.json["base"]["frames"] == ["0000", "0001", "0002"]
    assert run.json["base"]["origin"] == (
        "the median of 3 ok frames of 5, from their readings of the outer joints as they are; "
        "half of them lie within 0.0 mm and 0.0 deg of it"
    )


def test_without_an_ok_frame_the_doubtful_ones_are_taken_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    doubtful = [canned(f"000{k}", k, status="doubtful", reasons=("tiny",)) for k in range(2)]
    run = Run(capsys, write_results(tmp_path, *doubtful, canned("0005", camera_from_base=None)), "--to", "dvrk")
    assert run.code == 0
    assert run.error == ("dvrk-cmaes: warning: no frame that has a camera_from_base is ok: doubtful ones are used\n")


def test_frames_that_disagree_are_exported_with_a_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    turned = [canned(f"000{k}", camera_from_base=moved(BASE, [0, 0, 0, 0, 0, 0.3 * k])) for k in range(4)]
    run = Run(capsys, write_results(tmp_path, *turned), "--to", "dvrk", "--json")
    assert run.json["base"]["spread_deg"] > 5
    assert "the frames disagree: calibrate the session" in run.error


def test_one_doubtful_frame_is_exported_with_its_reasons(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = Run(capsys, results / "frames" / "0003.json", "--to", "dvrk", "--json")
    np.testing.assert_allclose(exported_base(run), OTHER, atol=1e-8)
    assert run.error == "dvrk-cmaes: warning: frame 0003 is doubtful: tiny\n"


def test_the_tf_line_alone_goes_to_stdout(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = Run(capsys, results, "--to", "tf", "--arm", "PSM3")
    (line,) = run.out.splitlines()
    assert line.startswith("ros2 run tf2_ros static_transform_publisher --x 0.0")
    assert line.endswith("--frame-id camera --child-frame-id PSM3_base")
    assert run.error.startswith("dvrk-cmaes: camera_from_base: the median of 3 ok frames of 5, ")
    assert not (results / "exports").exists()


def test_frames_without_a_pose_are_left_out_and_counted(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = Run(capsys, results, "--to", "tracker", "--json")
    assert run.json["left_out"] == ["0004"]
    assert run.error == "dvrk-cmaes: warning: no pose, left out (1): 0004\n"
    assert len(run.json["written"]) == 8


def complaint(run: Run) -> str:
    assert (run.code, run.out) == (2, "")
    assert run.error.count("\n") == 1
    return run.error.removeprefix("dvrk-cmaes: ").rstrip()


def test_without_any_base_it_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = write_results(tmp_path, canned("0001", camera_from_base=None), failed("0002"))
    assert complaint(Run(capsys, out, "--to", "dvrk")) == (
        f"{out}: camera_from_base: expected a session calibration (session.json), or frames that were estimated "
        "with yaw, pitch, insertion and roll; got 2 frames without"
    )
    assert complaint(Run(capsys, out, "--to", "tf", "--frame", "0001")) == (
        f"{out}: camera_from_base: expected 4 rows of 4 numbers, got none: frame 0001 was estimated without yaw, "
        "pitch, insertion and roll"
    )
    assert complaint(Run(capsys, out, "--to", "tf", "--frame", "0002")).endswith("got none: frame 0002 failed")
    assert not (out / "exports").exists()


def test_wrong_input_is_named(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert complaint(Run(capsys, results, "--to", "csv", "--frame", "0009")).startswith(
        f"{results}: frame: expected one of 5 frames (0000"
    )
    single = results / "frames" / "0001.json"
    assert (
        complaint(Run(capsys, single, "--to", "csv", "--frame", "0002"))
        == f"{single}: frame: expected '0002', got '0001'"
    )
    assert complaint(Run(capsys, results / "x", "--to", "csv")).startswith(f"{results / 'x'}: no such file; expected")
    assert complaint(Run(capsys, results, "--to", "bop", "--scene", "-1")).startswith("--scene, --object-id: expected")
    write_json(results / "session.json", {"camera_from_base": [[1, 2]]})
    assert complaint(Run(capsys, results, "--to", "dvrk")) == (
        f"{results / 'session.json'}: camera_from_base: expected 4 rows of 4 finite numbers, got [[1, 2]]"
    )


def test_a_result_cannot_lead_out_of_the_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.json"
    write_json(path, canned("../../evil").to_dict())
    assert complaint(Run(capsys, path, "--to", "tracker", "--out", tmp_path / "x")) == (
        "frame: expected a name that can be a file's (no slash, no leading dot), got '../../evil'"
    )


def test_the_median_pose_bears_a_third_of_nonsense() -> None:
    rng = np.random.default_rng(0)
    near = [moved(BASE, [*rng.normal(0, 1e-3, 3), *rng.normal(0, 0.01, 3)]) for _ in range(20)]
    far = [moved(BASE, [*rng.normal(0, 0.3, 3), *rng.normal(0, 2.0, 3)]) for _ in range(10)]
    found = median_pose(np.array([*near, *far]))
    assert np.linalg.norm(found[:3, 3] - BASE[:3, 3]) < 1e-3
    assert np.degrees(rotation_angle(found, BASE)) < 0.6
