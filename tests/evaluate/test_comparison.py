"""Comparison of sets of poses: the reference, differences by frame and in sum, and the kinds of sets that are read."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.canned_results import canned, write_results
from helpers.places import bundled_path
from helpers.transforms import moved

from dvrk_cmaes import Body, InputError, Result
from dvrk_cmaes.evaluate.compared_set import read_compared_set
from dvrk_cmaes.evaluate.comparison import Comparison, compare_sets
from dvrk_cmaes.frames.truth import FrameTruth, SessionTruth, write_golden
from dvrk_cmaes.results.result import ExpectedError

NAMES = ("a", "b", "c")


def by_mm(result: Result, millimetres: float) -> Result:
    """Give a result whose pose is shifted along the shaft."""
    assert result.camera_from_root is not None
    shift = [0, 0, millimetres / 1e3, 0, 0, 0]
    return replace(result, camera_from_root=moved(result.camera_from_root, shift))


def compared(body: Body, *paths: Path) -> Comparison:
    return compare_sets([read_compared_set(path) for path in paths], body.instrument)


@pytest.fixture
def before(tmp_path: Path) -> Path:
    return write_results(tmp_path / "before", *(canned(name, k) for k, name in enumerate(NAMES)))


def test_differences_are_those_made(bundled_body: Body, before: Path, tmp_path: Path) -> None:
    shifted = [by_mm(canned(name, k), mm) for k, (name, mm) in enumerate(zip(NAMES, (1, 3, 0.5), strict=True))]
    bent = replace(shifted[2], joints={**shifted[2].joints, "jaw": shifted[2].joints["jaw"] + 0.1})
    found = compared(bundled_body, before, write_results(tmp_path / "after", *shifted[:2], bent))
    assert [found.differences[1][name].root_mm for name in NAMES] == pytest.approx([1, 3, 0.5], abs=1e-4)
    assert [found.differences[1][name].tip_mm for name in "ab"] == pytest.approx([1, 3], abs=1e-4)
    assert found.differences[1]["c"].joints_deg["jaw"] == pytest.approx(np.degrees(0.1), abs=1e-5)
    spread = found.spreads(1)["root_mm"]
    assert (spread.median, spread.largest) == (pytest.approx(1, abs=1e-4), pytest.approx(3, abs=1e-4))
    assert spread.frame == "b"
    assert found.by_size[0] == "b"


def test_truth_is_reference_wherever_it_stands(bundled_body: Body, before: Path, tmp_path: Path) -> None:
    poses = {name: canned(name, k) for k, name in enumerate(NAMES)}
    golden = {
        name: FrameTruth(by_mm(one, 2).camera_from_root, one.joints)  # type: ignore[arg-type]
        for name, one in poses.items()
    }
    write_golden(tmp_path / "golden.json", SessionTruth(golden))
    found = compared(bundled_body, before, tmp_path / "golden.json")
    assert (found.reference, found.labels, found.others) == (1, ("A", "B"), (0,))
    assert [one.tip_mm for one in found.differences[0].values()] == pytest.approx([2, 2, 2], abs=1e-4)


def test_stated_errors_are_checked_with_truth(bundled_body: Body, tmp_path: Path) -> None:
    stated = [
        by_mm(
            canned(name, k, expected_error=ExpectedError({"mean": 1.0}, {}, 1.5, 0.5), covariance=np.eye(9) * 1e-9), mm
        )
        for k, (name, mm) in enumerate(zip(NAMES, (0.2, 1.4, 1.6), strict=True))
    ]
    results = write_results(tmp_path / "results", *stated)
    golden = {name: canned(name, k) for k, name in enumerate(NAMES)}
    truth = {name: FrameTruth(one.camera_from_root, one.joints) for name, one in golden.items()}  # type: ignore[arg-type]
    write_golden(tmp_path / "golden.json", SessionTruth(truth))
    assert compared(bundled_body, results, tmp_path / "golden.json").within_90(0) == (2, 3)
    assert compared(bundled_body, results, results).within_90(1) is None


def test_mirror_twin_is_named(bundled_body: Body, before: Path, tmp_path: Path) -> None:
    instrument = bundled_body.instrument
    one = canned("a", 0)
    pose, joints = instrument.twin(one.camera_from_root, [one.joints[name] for name in instrument.joint_names])
    twin = replace(one, camera_from_root=pose, joints=dict(zip(instrument.joint_names, joints.tolist(), strict=True)))
    found = compared(bundled_body, before, write_results(tmp_path / "after", twin))
    assert found.differences[1]["a"].is_twin
    assert found.to_dict()["sets"]["B"]["twins"] == ["a"]


_TRACKED = ("frame", "status", "reasons", "camera_from_root", "joints", "std", "tips", "seconds")  # of a result


def test_followed_recording_is_compared(bundled_body: Body, before: Path, tmp_path: Path) -> None:
    known = {"covariance": 1e-6 * np.eye(9), "tips": (np.zeros(3), np.zeros(3))}
    rows = [
        {key: replace(by_mm(canned(name, k), 1), **known).to_dict()[key] for key in _TRACKED} | {"time": k / 30}
        for k, name in enumerate(NAMES)
    ]
    rows[1] |= {"status": "lost", "camera_from_root": None, "joints": {}}
    (tmp_path / "tracks.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    found = compared(bundled_body, before, tmp_path)
    assert found.sets[1].kind == "followed recording"
    assert list(found.differences[1]) == ["a", "c"]
    assert found.to_dict()["sets"]["B"]["statuses"] == {"ok": 2, "lost": 1}


def test_session_folder_with_truth_is_read(tmp_path: Path) -> None:
    shutil.copy(bundled_path("demo") / "golden.json", tmp_path)
    assert read_compared_set(tmp_path).kind == "truth"


def test_unusable_sets_are_refused(bundled_body: Body, before: Path, tmp_path: Path) -> None:
    golden = bundled_path("demo") / "golden.json"
    with pytest.raises(InputError, match=r"no such folder; expected results, a golden.json, or a published.csv$"):
        read_compared_set(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"golden.json: expected one truth, got .*golden.json too$"):
        compared(bundled_body, golden, golden)
    with pytest.raises(InputError, match=r"before: expected frames with a pose in .*golden.json too, got none$"):
        compared(bundled_body, golden, before)
