"""scripts/answers.py: the answers of two checkouts compared value by value."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.batch_sessions import QUICK, make_session
from helpers.commands import Ran
from helpers.places import ROOT

from dvrk_cmaes.cli import main
from dvrk_cmaes.io.bundled import bundled_path

pytestmark = pytest.mark.usefixtures("scripts_on_path")

RESULT: dict[str, Any] = {
    "status": "doubtful",
    "reasons": ["iou 0.84 is below 0.85"],
    "camera_from_root": [[0.0, -1.0, 0.0, 0.01], [1.0, 0.0, 0.0, 0.02], [0.0, 0.0, 1.0, 0.1], [0.0, 0.0, 0.0, 1.0]],
    "joints": {"wrist": 0.2, "jaw": 0.5},
    "covariance": {
        "axes": ["tx", "ty", "tz", "rx", "ry", "rz", "wrist", "jaw"],
        "matrix": np.diag([1e-8, 4e-8, 1e-8, 1e-4, 1e-4, 1e-4, 1e-4, 4e-4]).tolist(),
    },
    "mode_probability": 0.97,
    "alternatives": [{"relation": "mirror twin", "loss": 0.3}, {"relation": "other mode", "loss": 0.4}],
    "lag": {"seconds": 0.03, "std_seconds": 0.01},
    "seconds": 0.31,
    "version": "1.0",
}


def row(this: Any, other: Any = RESULT) -> dict[str, Any]:
    from measure.answers.compare import compare

    return compare({"frames/a.json": this}, {"frames/a.json": other})


def changed(**fields: Any) -> dict[str, Any]:
    return {**copy.deepcopy(RESULT), **fields}


def accepted(row: dict[str, Any], largest_change: float | None = None) -> bool:
    from measure.answers.compare import accepted

    return accepted(row, largest_change)


def with_shift(metres: float) -> dict[str, Any]:
    """Give the result moved along the x axis of the root link, which is the y axis of the camera."""
    pose = np.array(RESULT["camera_from_root"])
    pose[1, 3] += metres
    return changed(camera_from_root=pose.tolist())


def test_equal_documents() -> None:
    found = row(changed())
    assert (found["files"], found["differ"], found["largest relative"], found["largest change"]) == (1, 0, 0.0, 0.0)
    assert found["values"] > 80
    assert accepted(found)


def test_one_digit() -> None:
    found = row(changed(mode_probability=0.970000001))
    assert found["differ"] == 1
    assert found["largest relative"] == pytest.approx(1e-9 / 0.97, rel=1e-3)
    assert found["first"] == ["frames/a.json: mode_probability: 0.97 -> 0.970000001"]
    assert found["verdicts"] == []
    assert not accepted(found)
    assert accepted(found, 0.05)


def test_times_of_computation_and_versions_are_left_out() -> None:
    assert accepted(row(changed(seconds=0.5, version="2.0", timing={"total": 3})))


def test_seconds_of_a_lag_are_compared() -> None:
    assert row(changed(lag={"seconds": 0.031, "std_seconds": 0.01}))["differ"] == 1


@pytest.mark.parametrize("this", [{**RESULT, "rays": 1}, {k: v for k, v in RESULT.items() if k != "joints"}])
def test_field_of_one_checkout_only(this: dict[str, Any]) -> None:
    assert row(this)["differ"] > 0


@pytest.mark.parametrize(("this", "equal"), [(1, True), (1.0, True), (True, False), ("1", False), (None, False)])
def test_values_of_other_types(this: Any, equal: bool) -> None:
    assert (row({"value": this}, {"value": 1})["differ"] == 0) is equal


def test_missing_file() -> None:
    from measure.answers.compare import compare

    found = compare({"a.json": {}}, {"a.json": {}, "b.json": {}})
    assert found["missing"] == ["b.json: missing in this checkout"]
    assert not accepted(found, 1e9)


def test_list_of_another_length() -> None:
    found = row({"rings": [1, 2]}, {"rings": [1, 2, 3]})
    assert found["differ"] == 1


@pytest.mark.parametrize(
    ("fields", "verdict"),
    [
        ({"status": "ok"}, "status 'doubtful' -> 'ok'"),
        ({"reasons": ["the shaft is bent"]}, "reasons ['iou # is below #'] -> ['the shaft is bent']"),
        ({"alternatives": RESULT["alternatives"][::-1]}, "modes ['mirror twin', 'other mode'] -> ['other mode', 'mi"),
        ({"mode_probability": 0.972}, "mode probability 0.97 -> 0.972"),
        ({"camera_from_root": None}, "pose is gone"),
        ({"left_out": [{"frame": "0001", "reason": "no pose"}]}, "left out [] -> ['0001']"),
    ],
)
def test_changed_verdict_is_named_and_never_accepted(fields: dict[str, Any], verdict: str) -> None:
    found = row(changed(**fields))
    assert found["verdicts"][0].startswith(f"frames/a.json: {verdict}")
    assert not accepted(found, 1e9)


def test_changed_number_in_a_reason_is_no_other_reason() -> None:
    found = row(changed(reasons=["iou 0.83 is below 0.85"]))
    assert (found["differ"], found["verdicts"]) == (1, [])


def test_change_is_in_standard_deviations_along_the_axes_of_the_root_link() -> None:
    found = row(with_shift(3e-5))  # the standard deviation of tx is 1e-4 m
    assert found["largest change"] == pytest.approx(0.3 / np.sqrt(8))
    assert accepted(found, 0.11)
    assert not accepted(found, 0.1)


def test_change_of_a_joint() -> None:
    assert row(changed(joints={"wrist": 0.2, "jaw": 0.52}))["largest change"] == pytest.approx(1 / np.sqrt(8))


def test_change_along_a_well_known_direction_counts_more() -> None:
    covariance = copy.deepcopy(RESULT["covariance"])
    covariance["matrix"][0][1] = covariance["matrix"][1][0] = 1.9e-8
    other = changed(covariance=covariance)
    found = row({**with_shift(3e-5), "covariance": covariance}, other)
    assert found["largest change"] > 0.9 / np.sqrt(8)


def test_change_of_followed_frames_is_in_their_standard_deviations() -> None:
    std = {"translation_mm": [0.1, 0.2, 0.1], "rotation_deg": [1.0, 1.0, 1.0], "joints_deg": {"wrist": 1.0, "jaw": 1.0}}
    lines = [{**RESULT, "covariance": None, "std": std}, {**with_shift(3e-5), "covariance": None, "std": std}]
    found = row(lines, [lines[0], lines[0]])
    assert found["largest change"] == pytest.approx(0.3 / np.sqrt(8))


def test_files_of_a_folder(tmp_path: Path) -> None:
    from measure.answers.compare import read_answers

    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "poses.csv").write_text("frame,x_mm,reasons\n0001,1.50,\n", encoding="utf-8")
    (tmp_path / "out" / "tracks.jsonl").write_text('{"x": 1}\n{"x": 2}\n', encoding="utf-8")
    (tmp_path / "run.json").write_text(json.dumps({"session": f"{tmp_path}/inputs"}), encoding="utf-8")
    (tmp_path / "report.html").write_text("", encoding="utf-8")
    assert read_answers(tmp_path) == {
        "out/poses.csv": [{"frame": 1.0, "x_mm": 1.5, "reasons": ""}],
        "out/tracks.jsonl": [{"x": 1}, {"x": 2}],
        "run.json": {"session": "FOLDER/inputs"},
    }


@pytest.mark.usefixtures("compiled_before")
def test_checkout_compared_with_itself(
    run_here: Callable[..., Ran], tasks_here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the commands of this checkout run in the tests' process, those of the other one in processes of their own
    import answers

    run = answers.Checkout.run

    def run_this_here(checkout: Any, arguments: list[str], folder: Path, **variables: str) -> int:
        if checkout.name == "other":
            return int(run(checkout, arguments, folder, **variables))
        with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
            return main(arguments)

    monkeypatch.setattr(answers.Checkout, "run", run_this_here)

    def write(folder: Path) -> None:
        make_session(folder, ["0000", "0001", "0002"])
        shutil.copy(bundled_path("demo", "golden.json"), folder)
        (folder / "quick.toml").write_text(QUICK, encoding="utf-8")

    options = ("--out", "out", "--workers", "1", "--config", "inputs/quick.toml")
    monkeypatch.setattr(
        answers, "CASES", (answers.Case("demo", write, (("batch", "inputs", *options),), bundled=True),)
    )
    done = run_here("answers", "--against", ROOT, "--only", "demo", "--json")
    assert done.code == 0, done.err
    demo = done.result["cases"]["demo"]
    assert demo["differ"] == 0
    assert demo["files"] > 10
    assert demo["values"] > 1000


def test_folder_without_package_is_refused(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    done = run_here("answers", "--against", tmp_path)
    assert done.code == 2
    assert done.err == f"answers.py: --against {tmp_path}: expected a checkout with the package dvrk_cmaes\n"


def test_answers_are_kept_for_a_commit_and_its_inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import answers
    from measure.answers.cases import Case

    runs: list[str] = []
    monkeypatch.setattr(answers, "commit_of", lambda folder: "c8c8a2f")
    monkeypatch.setattr(answers, "answers_of", lambda checkout, case, instrument: runs.append(case.name) or {"a": [1]})

    def write(folder: Path, text: str = "1") -> None:
        folder.mkdir()
        (folder / "joints.csv").write_text(text, encoding="utf-8")

    case = Case("made/easy", write, (("batch",),))
    checkout = answers.Checkout("other", tmp_path, "", "")
    for _ in range(2):
        assert answers._kept(checkout, case, "lnd", tmp_path / "kept") == {"a": [1]}
    assert len(runs) == 1
    other_inputs = Case("made/easy", lambda folder: write(folder, "2"), (("batch",),))
    answers._kept(checkout, other_inputs, "lnd", tmp_path / "kept")
    assert len(runs) == 2
    monkeypatch.setattr(answers, "commit_of", lambda folder: None)
    answers._kept(checkout, other_inputs, "lnd", tmp_path / "kept")
    assert len(runs) == 3


def test_answers_on_other_processors_may_differ_in_digits_but_not_in_verdicts(
    run_here: Callable[..., Ran], monkeypatch: pytest.MonkeyPatch
) -> None:
    import answers
    from measure.answers.processors import Processor

    frame = {"status": "ok", "reasons": [], "camera_from_root": np.eye(4).tolist(), "loss": 1.0}
    given = {"": frame, "x": frame | {"loss": 1.0000001}, "y": frame | {"status": "doubtful"}}
    others = [
        Processor("digits", {"CPU": "x"}),
        Processor("status", {"CPU": "y"}),
        Processor("none", {}, "no such set"),
    ]
    monkeypatch.setattr(answers, "processors", lambda: others)
    monkeypatch.setattr(
        answers,
        "answers_of",
        lambda _, case, instrument, variables=None: {"a.json": given[(variables or {}).get("CPU", "")]},
    )
    done = run_here("answers", "--processors", "--only", "demo", "--json")
    assert done.code == 1, done.err
    rows = done.result["processors"]
    assert {name: row["accepted"] for name, row in rows.items()} == {
        "demo, digits": True,
        "demo, status": False,
        "demo, none": True,
    }
    assert rows["demo, none"]["not run"] == "no such set"
    assert rows["demo, digits"]["differ"] == 1


def test_processors_are_told_to_the_libraries() -> None:
    from measure.answers.processors import processors

    found = processors()
    assert [one.name for one in found][:3] == ["BLAS Haswell", "BLAS Zen", "BLAS SkylakeX"]
    assert all(one.lacking or all(one.variables.values()) for one in found)
    assert {name for one in found for name in one.variables} == {
        "OPENBLAS_CORETYPE",
        "OPENCV_CPU_DISABLE",
        "NPY_DISABLE_CPU_FEATURES",
    }
