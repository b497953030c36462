"""scripts/worlds and accuracy.py worlds: the table has every pair, pictures agree with the truth, figures are right."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from helpers.commands import Ran
from helpers.places import SCRIPTS

from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.geometry import apply
from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.synth.truth import Truth, exact_coverage

if TYPE_CHECKING:
    from worlds.table import World

pytestmark = pytest.mark.usefixtures("scripts_on_path")


def a_world(**changes: Any) -> World:
    from worlds.table import World

    usual = World(
        number=0,
        size=(320, 240),
        focal=1.6,
        lens="none",
        distance=0.12,
        instrument="lnd",
        side="left",
        arm="classic",
        images_hz=30,
        readings_hz=50,
        colour="colour",
        border="none",
        tools=1,
        level="easy",
    )
    return replace(usual, **changes)


def test_each_pair_that_can_be_seen_is_in_the_table() -> None:
    from worlds.table import VALUES, can_be_seen, worlds

    table = worlds(["lnd", "other.urdf"])
    assert len(table) < 100
    assert table == worlds(["lnd", "other.urdf"])
    assert [world.number for world in table] == [*range(len(table))]
    values = {**VALUES, "instrument": ("lnd", "other.urdf")}
    rows = [{name: getattr(world, name) for name in values} for world in table]
    assert all(can_be_seen(row) for row in rows)
    for a, b in combinations(values, 2):
        found = {(row[a], row[b]) for row in rows}
        assert found == {(x, y) for x, y in product(values[a], values[b]) if can_be_seen({a: x, b: y})}
    assert {(0.5, 0.35), (3.0, 0.05)} & {(row["focal"], row["distance"]) for row in rows} == {(0.5, 0.35)}
    assert all(world.camera.width == world.size[0] for world in table)  # no lens is refused


def test_generator_shares_no_code_with_silhouettes() -> None:
    code = "import sys; import worlds.folders; print([m for m in sys.modules if m.startswith('dvrk_cmaes.silhouette')])"
    done = subprocess.run([sys.executable, "-c", code], cwd=SCRIPTS, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("lens", ["none", "barrel", "rational"])
def test_coverage_is_that_of_the_silhouette(bundled_body: Body, lens: Any) -> None:
    from worlds.drawing import draw_tools
    from worlds.motion import draw_motion

    world = a_world(lens=lens, focal=0.8, distance=0.08)
    (placed,) = draw_motion(world, 1).placed(np.array([2.0]))
    joints = dict(zip(bundled_body.instrument.joint_names, placed.joints.tolist(), strict=True))
    truth = Truth(bundled_body.instrument, placed.camera_from_root, joints)
    (drawn,), expected = draw_tools(world.camera, [placed]).coverage, exact_coverage(bundled_body, world.camera, truth)
    assert 0.01 < expected.mean() < 0.3
    assert drawn.sum() == pytest.approx(expected.sum(), rel=5e-3)
    assert np.abs(drawn - expected).max() < 0.35
    assert np.abs(drawn - expected)[(drawn > 0) & (drawn < 1)].mean() < 0.05


def test_frames_of_a_motion_stay_in_the_picture_and_readings_tell_the_twin() -> None:
    from worlds.motion import NOMINAL, draw_motion, frame_times, in_picture, lag_of, read_motion

    world = a_world(level="hard", arm="si", border="bars", side="right", readings_hz=10)
    moving = draw_motion(world, 3)
    assert 0 < lag_of(world, 3) <= 0.12
    for kind in ("session", "recording"):
        times = frame_times(world, kind, NOMINAL[kind])
        assert in_picture(world, moving.points(times))
        read = read_motion(world, 3, moving, kind)
        assert np.diff(read.times) == pytest.approx(0.1)
        assert read.times[0] < times[0] < times[-1] < read.times[-1]
        at = moving.joints(read.times)
        assert np.abs(read.values - at)[:, :2].max() < np.deg2rad(0.6)
        assert np.abs(np.mean(read.values - at, axis=0)[4:]).max() > np.deg2rad(1)
        shown = moving.joints(times)
        read_then = np.stack([np.interp(times, read.times, column) for column in read.values.T], axis=1)
        wrist = slice(4, 6)
        to_truth = np.linalg.norm((read_then - shown)[:, wrist], axis=1)
        assert (to_truth < np.linalg.norm((read_then + shown)[:, wrist], axis=1)).all()


def test_two_tools_are_labels_of_a_session_of_two_arms(tmp_path: Path) -> None:
    from worlds.folders import drawn_folder

    world = a_world(size=(160, 120), tools=2, border="circle", colour="grey", level="hard", readings_hz=5)
    drawn = drawn_folder(tmp_path, world, 2, "recording", 2)
    entries = read_session_toml(drawn.path)
    assert entries is not None
    assert [(tool.arm, tool.label) for tool in entries.tools] == [("PSM2", (1,)), ("PSM1", (2,))]
    labels = cv2.imread(str(drawn.path / "masks" / "0000.png"), cv2.IMREAD_UNCHANGED)
    assert set(np.unique(labels)) == {0, 1, 2}
    assert cv2.imread(str(drawn.path / "images" / "0000.jpg"), cv2.IMREAD_UNCHANGED).shape == (120, 160)
    border = cv2.imread(str(drawn.path / "ignore" / "0000.png"), cv2.IMREAD_UNCHANGED)
    ignored = cv2.imread(str(drawn.path / "ignored" / "0000.png"), cv2.IMREAD_UNCHANGED)
    assert border[0, 0] == 255
    assert border[60, 80] == 0
    assert (ignored[labels == 2] == 255).all()
    assert (ignored[(labels == 1)] == 0).all()
    assert drawn.times()["0001"] - drawn.times()["0000"] == pytest.approx(1 / 30, abs=2e-6)
    assert set(drawn.nearest_readings(1001.61)) >= {"yaw", "pitch", "insertion", "roll", "jaw"}


def test_small_world_is_drawn_and_solved_once(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    from measure.accuracy.worlds import worlds_report

    report = worlds_report([a_world()], tmp_path, frames=2, only=["estimate"])
    (row,) = report["all"]
    assert (row["worlds"], row["failed"], row["frames"], row["ok and wrong"]) == (1, 0, 2, 0)
    assert row["right mode"] == 1
    assert row["ends, mm"] < 1
    (folder,) = tmp_path.glob("seed0/000/session-2")
    session = read_session(folder)
    assert [frame.time for frame in session.frames] == pytest.approx([1001.5, 1002.8])
    assert session.truth.camera_from_base is not None
    written = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    assert worlds_report([a_world()], tmp_path, frames=2, only=["estimate"]) == report
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()} == written
    refused = run_here("accuracy", "worlds", tmp_path, tmp_path)
    assert refused.code == 2
    assert "expected one folder" in refused.err


def test_whole_session_is_calibrated(tmp_path: Path) -> None:
    from measure.accuracy.worlds import solved
    from worlds.folders import drawn_folder

    found = solved(drawn_folder(tmp_path, a_world(), 0, "session", 4), "calibrate")
    assert found.failures == ()
    assert len(found.frames) >= 3
    assert max(frame.error_mm for frame in found.frames) < 2
    assert not found.recording_wrong


def test_frames_are_compared_with_the_truth(tmp_path: Path) -> None:
    from measure.accuracy.worlds import scored
    from worlds.folders import Folder

    joints = {"wrist_pitch": 0.1, "wrist_yaw": 0.2, "jaw": 0.3}
    pose = np.eye(4)
    pose[2, 3] = 0.1
    ends = apply(pose, load_instrument("lnd").ends([0.1, 0.2, 0.3])).tolist()
    truth = {"T_camera_roll_link": pose.tolist(), "tips_camera_m": ends, "visible": 1.0, "overlap": 0.95}
    frames = dict.fromkeys("abcd", truth) | {"hidden": truth | {"visible": 0.0}}
    (tmp_path / "golden.json").write_text(json.dumps({"frames": frames}), encoding="utf-8")
    std = {"tip_mm": {"jaw_1": 0.4, "jaw_2": 0.6, "mean": 0.1}}
    shifted = pose + np.eye(4, k=3) * 1e-3
    close = {"status": "ok", "camera_from_root": shifted.tolist(), "joints": joints}
    turned = close | {"camera_from_root": (pose @ np.diag([-1.0, -1, 1, 1])).tolist(), "quality": {"iou": 0.9}}
    without_jaws = {"tip_mm": None, "translation_mm": [0.0, 0.3, 0.4]}
    found = {"a": close | {"std": std}, "b": turned | {"std": {"tip_mm": 2.0}}, "d": close | {"std": without_jaws}}
    a, b, c, d = scored(Folder(tmp_path, a_world(), "session", 5), found)
    assert (a.error_mm, a.std_mm, a.rotation_deg, a.limit_mm) == pytest.approx((1.0, 0.5, 0.0, 3.0))
    assert (a.solved, a.missed) == (True, False)
    assert (b.std_mm, b.rotation_deg, b.limit_mm) == pytest.approx((2.0, 180.0, 6.0))
    assert (b.solved, b.missed) == (False, True)
    assert d.std_mm == pytest.approx(0.5)
    assert (c.status, c.error_mm, c.solved) == ("failed", 1000, False)


def test_figures_count_what_is_wrong_and_what_failed(tmp_path: Path) -> None:
    from measure.accuracy.worlds import Failure, Scored, Solved, run, tables

    fine = Scored("a", "ok", 0.5, 0.4, 2.0, 3.0)
    wrong = replace(fine, frame="b", error_mm=3.5)
    doubted = replace(fine, frame="c", status="doubtful", error_mm=50.0, rotation_deg=175.0)
    assert [frame.solved for frame in (fine, wrong, doubted)] == [True, False, False]
    assert [frame.wrong for frame in (fine, wrong, doubted)] == [False, True, False]
    out, failure = run(["estimate", "--mask", str(tmp_path / "none.png"), "--joints", "none", "--camera", "none"], "a")
    assert out == ""
    assert failure == Failure("a", 2, failure.error, failure.run) if failure else False
    found = [
        Solved(a_world(), "track", (fine, wrong, doubted), (failure,), 1.0),
        Solved(a_world(number=1, lens="barrel"), "track", (fine, fine, fine, fine, wrong), (), 2.0),
    ]
    assert [each.recording_wrong for each in found] == [True, False]
    report = json.loads(json.dumps(tables(found)))
    (row,) = report["all"]
    assert (row["worlds"], row["failed"], row["frames"], row["recordings wrong"], row["ok and wrong"]) == (
        2,
        1,
        8,
        1,
        2,
    )
    assert row["solved"] == pytest.approx(5 / 8)
    assert row["worst ok, mm"] == 3.5
    lenses = {row["value"]: row["frames"] for row in report["track, by value"] if row["parameter"] == "lens"}
    assert lenses == {"none": 3, "barrel": 5}
    assert [(each["world"], each["code"]) for each in report["failed"]] == [(0, 2)]
    assert [each["frame"] for each in report["ok and wrong"]] == ["b", "b"]
