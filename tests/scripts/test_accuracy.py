"""scripts/accuracy.py: errors, intervals, bounds and false inputs, each checked against a known answer."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from helpers.commands import Ran
from helpers.places import ROOT, SCRIPTS

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import moved, transform
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body, Renderer

if TYPE_CHECKING:
    from measure.cases import Case, Run


pytestmark = pytest.mark.usefixtures("scripts_on_path")


def a_run(case: Case, pose: np.ndarray, joints: Mapping[str, float], spread: np.ndarray | None = None) -> Run:
    """Make a run that ended at a pose, with given standard deviations (9,) of [t, r, joints]."""
    from measure.cases import Run

    result = Result.failed("", "", {}, instrument="lnd", root_link="roll_link")
    covariance = np.diag((np.ones(9) if spread is None else spread) ** 2)
    result = replace(result, status="ok", camera_from_root=pose, joints=dict(joints), covariance=covariance)
    return Run(case, result)


def wrist(case: Case) -> dict[str, float]:
    assert case.truth is not None
    return {name: case.truth.joints[name] for name in ("wrist_pitch", "wrist_yaw", "jaw")}


def test_error_of_two_std_has_distance_two(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.calibration import distances

    instrument, case = bundled_body.instrument, cases[0]
    assert case.truth is not None
    spread = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3, 0.01, 0.02, 0.03])
    joints = wrist(case)
    found = joints | {"wrist_yaw": joints["wrist_yaw"] + 0.04}
    squared = distances(instrument, a_run(case, case.truth.camera_from_root, found, spread))
    assert squared["wrist_yaw"] == pytest.approx((4.0, 1))
    assert squared["jaw"] == pytest.approx((0.0, 1))
    assert squared["axis direction"] == pytest.approx((0.0, 2))

    turned = moved(case.truth.camera_from_root, np.array([0, 0, 0, 0.002, 0, 0]))
    squared = distances(instrument, a_run(case, turned, joints, spread))
    assert squared["axis direction"][0] == pytest.approx(4.0, rel=1e-3)

    shifted = moved(case.truth.camera_from_root, np.array([3e-4, 0, 0, 0, 0, 0]))
    only_translation = spread * np.array([1, 1, 1, *np.full(6, 1e-4)])
    squared = distances(instrument, a_run(case, shifted, joints, only_translation))
    assert squared["tip 1"] == pytest.approx((9.0, 3), rel=0.01)


def test_share_interval_is_clopper_pearson() -> None:
    from measure.accuracy.figures import share_interval

    assert share_interval(9, 10) == pytest.approx((0.5550, 0.9975), abs=1e-4)
    assert share_interval(0, 10)[0] == 0
    assert share_interval(10, 10)[1] == 1


def test_spread_ignores_common_error_along_shaft(cases: list[Case]) -> None:
    from measure.accuracy.errors import session_spread

    rng = np.random.default_rng(1)
    base = transform(np.eye(3), [0.01, 0.02, 0.2])
    runs = []
    for _ in range(6):
        outer = {
            "yaw": rng.uniform(-0.3, 0.3),
            "pitch": rng.uniform(-0.3, 0.3),
            "insertion": rng.uniform(0.1, 0.2),
            "roll": rng.uniform(-1, 1),
        }
        case = replace(cases[0], readings=outer)
        runs.append(a_run(case, base @ base_from_root(outer), {}))
    assert session_spread(runs) == pytest.approx({"sigma_mm": 0, "sigma_rms_mm": 0, "rcm_mm": 0}, abs=1e-9)

    shifted = [a_run(run.case, moved(run.pose, np.array([0, 0, 0.01, 0, 0, 0])), {}) for run in runs]
    spread = session_spread(shifted)
    assert spread["sigma_rms_mm"] == pytest.approx(0, abs=1e-9)
    assert 0.1 < spread["rcm_mm"] < 10


def test_crossing_rates_sum_to_change_of_area(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.bound import find_crossings

    case = cases[0]
    assert case.truth is not None
    true = case.true(bundled_body.instrument)
    rates = find_crossings(bundled_body, case, true).rates.sum(axis=1)
    renderer = Renderer(bundled_body, case.camera, threads=1)
    steps = np.array([2e-5] * 3 + [2e-4] * 6)
    change = np.concatenate([np.diag(steps), -np.diag(steps)])
    area = renderer.coverage(true.moved(change).pose, true.moved(change).joints, lines_per_pixel=8).sum(axis=(1, 2))
    measured = (area[:9] - area[9:]) / (2 * steps)
    assert rates == pytest.approx(measured, rel=0.05, abs=0.02 * np.abs(rates).max())


def test_bound_decreases_with_pixels_and_readings(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.bound import least_covariance

    from dvrk_cmaes.config import EstimateConfig

    case, config = cases[0], EstimateConfig()
    with_readings = np.diag(least_covariance(bundled_body, case, config))
    without = np.diag(least_covariance(bundled_body, replace(case, readings={}), config))
    camera = case.camera.scaled(2 * case.camera.width, 2 * case.camera.height)
    finer = np.diag(least_covariance(bundled_body, replace(case, readings={}).with_camera(camera), config))
    assert (with_readings <= without * (1 + 1e-9)).all()
    # twice the rows, each with half the error in px
    assert np.sqrt(without / finer) == pytest.approx(2 * np.sqrt(2), rel=0.15)


def test_false_inputs_change_stated_part_only(cases: list[Case]) -> None:
    from measure.accuracy.lies import FALSIFICATIONS, falsified_cases

    made = falsified_cases(cases, {}, 4, seed=0)
    kinds = [kind for kind in FALSIFICATIONS if not kind.endswith("needle driver")]
    assert [case.kind for case in made] == [kind for kind in kinds for _ in range(4)]
    honest = {case.frame: case for case in cases}
    for lie in made:
        truth = honest[lie.frame.split("_")[0]]
        same_mask = np.array_equal(lie.mask, truth.mask)
        assert same_mask == (lie.kind in ("readings 60 deg off", "focal length off"))
        assert (lie.camera == truth.camera) == (lie.kind != "focal length off")
        off = {name: value - truth.readings[name] for name, value in lie.readings.items()}
        assert sum(value != 0 for value in off.values()) == (lie.kind == "readings 60 deg off")
        if lie.kind == "readings 60 deg off":
            assert np.rad2deg(max(off.values(), key=abs)) == pytest.approx(60) or np.rad2deg(
                min(off.values())
            ) == pytest.approx(-60)
        if lie.kind == "half a mask":
            assert 0.3 < lie.mask.sum() / truth.mask.sum() < 0.7
        if lie.kind == "two tools":
            assert (lie.mask & ~truth.mask).any()
            assert (lie.mask | truth.mask == lie.mask).all()


def test_mistakes_change_every_frame_alike_and_camera_files_are_read_critically(
    bundled_body: Body, cases: list[Case]
) -> None:
    from measure.accuracy.mistakes import MISTAKES, OTHER_MESHES, mistaken_cases

    made = mistaken_cases(cases[:2], bundled_body)
    assert [case.kind for case in made] == [kind for kind in (*MISTAKES, OTHER_MESHES) for _ in range(2)]
    of_kind = {case.kind: case for case in made}
    honest = cases[1]
    remarked = {kind for kind, case in of_kind.items() if case.camera.remarks}
    assert remarked == {"cx and cy exchanged", "camera file of half the size", "fx and fy 15 % apart"}
    masks = {kind for kind, case in of_kind.items() if not np.array_equal(case.mask, honest.mask)}
    assert masks == {"corner cropped, resized back", "mask 3 px wide", OTHER_MESHES}
    turned = of_kind["both wrist signs wrong"].readings
    assert turned["wrist_yaw"] == -honest.readings["wrist_yaw"]
    swapped = of_kind["wrist columns exchanged"].readings
    assert (swapped["wrist_pitch"], swapped["jaw"]) == (honest.readings["wrist_yaw"], honest.readings["jaw"])


def test_mistakes_are_counted_where_an_ok_frame_is_far_off(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.mistakes import mistake_row

    case, instrument = cases[0], bundled_body.instrument
    assert case.truth is not None
    right = result_of(case, case.truth.camera_from_root)
    moved = case.truth.camera_from_root.copy()
    moved[2, 3] += 0.005
    far = result_of(case, moved)
    said = replace(far, status="doubtful", reasons=("session: the camera file is contradicted",))
    row = mistake_row(instrument, "kind", [(right, case), (far, case), (said, case)])
    assert (row["frames"], row["ok"], row["ok_beyond_3_mm"], row["remarked"]) == (3, 2, 1, 1)
    assert row["tip_mm"] == pytest.approx(5.0, abs=0.01)


def result_of(case: Case, pose: np.ndarray) -> Result:
    """Give an ok result of a case with the true joints."""
    assert case.truth is not None
    return Result(case.frame, "ok", (), "lnd", "roll_link", pose, dict(case.truth.joints), {})


def test_quick_run_reports_json_and_reuses_results(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    options = ["errors", "--quick", "--json", "--workers", "1", "--keep", str(tmp_path), str(ROOT / "data" / "demo")]
    done = subprocess.run(
        [sys.executable, str(SCRIPTS / "accuracy.py"), *options],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report: dict[str, Any] = json.loads(done.stdout)
    (session,) = report["sessions"]
    assert (session["frames"], session["right_mode"], session["ok"]) == (2, 1, 1)
    assert session["tip_mm"][0] < 1
    assert len(list((tmp_path / "demo" / "honest").iterdir())) == 2
    again = run_here("accuracy", *options)
    assert again.code == 0, again.err
    assert again.result == report  # equal seconds: nothing is estimated again


def test_frame_with_empty_mask_is_left_out_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from measure.cases import Measurement

    session = tmp_path / "demo"
    shutil.copytree(ROOT / "data" / "demo", session)
    cv2.imwrite(str(session / "masks" / "0002.png"), np.zeros((480, 640), np.uint8))
    cases = Measurement([str(session)]).cases()
    assert [case.frame for case in cases] == ["0000", "0001", "0003", "0004"]
    assert "frame 0002 is left out" in capsys.readouterr().err
    for mask in (session / "masks").iterdir():
        cv2.imwrite(str(mask), np.zeros((480, 640), np.uint8))
    with pytest.raises(InputError, match="a frame that can be used"):
        Measurement([str(session)]).cases()


def test_missing_session_is_refused(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    done = run_here("accuracy", "errors", tmp_path / "none")
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "no such folder" in done.err
