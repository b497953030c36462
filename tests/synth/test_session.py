"""Synthetic sessions: consistent truth, errors as each level states, reproducible files and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import main
from helpers.places import bundled_path

from dvrk_cmaes import Body, InputError, Renderer, Session, load_instrument, read_frame, read_session
from dvrk_cmaes.estimation.pnp.frame import pose_from_markers
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.frames.markers import read_detections, read_marker_table
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.synth.levels import LEVELS, LevelName
from dvrk_cmaes.synth.readings import level_errors, sample_readings
from dvrk_cmaes.synth.session import SessionPlan, default_camera, write_session
from dvrk_cmaes.synth.truth import Truth

TABLE = read_marker_table(bundled_path("markers", "lnd.json"))
WRIST = ("wrist_pitch", "wrist_yaw", "jaw")


def plan(body: Body, level: LevelName = "medium", **changes: Any) -> SessionPlan:
    start = SessionPlan(
        body, default_camera(LEVELS[level]).scaled(320, 240), LEVELS[level], "rcm", frames=2, seed=5, markers=TABLE
    )
    return replace(start, **changes)


@pytest.fixture(scope="module")
def made(bundled_body: Body, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Session]:
    """Write a session with images for each level; gives them by level."""
    folder = tmp_path_factory.mktemp("made")
    for level in LEVELS:
        write_session(folder / level, plan(bundled_body, level))
    return {level: read_session(folder / level) for level in LEVELS}


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# what a session holds


@pytest.mark.parametrize("level", LEVELS)
def test_synthetic_session_is_read(made: dict[str, Session], level: str) -> None:
    session = made[level]
    assert [frame.name for frame in session.frames] == ["0000", "0001"]
    for frame in session.frames:
        data = read_frame(frame, session.camera)
        assert data.image is not None
        assert data.image.shape == (*data.mask.shape, 3)
        assert set(frame.readings) == {*WRIST, "yaw", "pitch", "insertion", "roll"}
        assert (data.ignore is not None) == (LEVELS[level].lens_edge is not None)  # type: ignore[index]
    assert session.camera.is_pinhole == (not LEVELS[level].distortion)  # type: ignore[index]


@pytest.mark.parametrize("level", LEVELS)
def test_true_silhouette_agrees_with_mask(made: dict[str, Session], bundled_body: Body, level: str) -> None:
    least = {"clean": 0.998, "easy": 0.98, "medium": 0.93, "hard": 0.8}[level]
    session = made[level]
    for frame in session.frames:
        truth, data = session.truth.frames[frame.name], read_frame(frame, session.camera)
        values = np.array([[truth.joints[name] for name in WRIST]])
        seen = Renderer(bundled_body, session.camera, threads=1).masks(truth.camera_from_root[None], values)[0]
        counts = np.ones_like(data.mask) if data.ignore is None else ~data.ignore
        overlap = (seen & data.mask & counts).sum() / ((seen | data.mask) & counts).sum()
        assert least < overlap
        assert level == "clean" or overlap < 0.998


def test_frames_share_one_base(made: dict[str, Session]) -> None:
    truth = made["hard"].truth
    assert truth.camera_from_base is not None
    for frame in truth.frames.values():
        np.testing.assert_allclose(
            truth.camera_from_base @ base_from_root(frame.joints), frame.camera_from_root, atol=1e-7
        )


def test_markers_and_tips_agree_with_truth(made: dict[str, Session], bundled_body: Body) -> None:
    session = made["clean"]
    seen = read_detections(session.folder / "markers.csv")
    for frame in session.frames:
        truth = session.truth.frames[frame.name]
        exact = replace(frame, readings=truth.joints)
        result = pose_from_markers(exact, session.camera, bundled_body.instrument, TABLE, seen[frame.name])
        assert result.camera_from_root is not None
        error = compare_poses(
            bundled_body.instrument, (result.camera_from_root, result.joints), (truth.camera_from_root, truth.joints)
        )
        assert error.root_mm < 4
        tips = bundled_body.instrument.tips([truth.joints[name] for name in WRIST])
        pixels = session.camera.project(tips @ truth.camera_from_root[:3, :3].T + truth.camera_from_root[:3, 3])
        assert frame.keypoints is not None
        off = np.linalg.norm(frame.keypoints[:, None] - pixels, axis=2)
        assert min(off[[0, 1], [0, 1]].max(), off[[0, 1], [1, 0]].max()) < 6


# levels and seeds


def test_files_depend_on_plan_and_seed_only(bundled_body: Body, tmp_path: Path) -> None:
    for name, changes in (("a", {}), ("b", {}), ("c", {"seed": 6})):
        write_session(tmp_path / name, plan(bundled_body, "hard", frames=1, **changes), images=False)
    a, b, c = (files_of(tmp_path / name) for name in "abc")
    assert a == b
    assert a["golden.json"] != c["golden.json"]
    assert a["masks/0000.png"] != c["masks/0000.png"]


def test_reading_errors_agree_with_level(bundled_body: Body) -> None:
    level, instrument = LEVELS["medium"], bundled_body.instrument
    rng = np.random.default_rng(3)
    errors: dict[str, list[list[float]]] = {name: [] for name in level_errors(level)}
    for _ in range(150):
        truths = []
        for _ in range(4):
            joints = dict(zip(WRIST, (*rng.uniform(0.5, 0.7, 2), rng.uniform(0.5, 0.6)), strict=True))
            truths.append(Truth(instrument, np.eye(4), joints, {"yaw": 0, "pitch": 0, "insertion": 0.1, "roll": 0}))
        readings = sample_readings(truths, rng, level, one_session=True)
        for name, found in errors.items():
            both = zip(readings, truths, strict=True)
            found.append([read[name] - {**true.outer, **true.joints}[name] for read, true in both])
    rms = {name: np.sqrt(np.mean(np.square(found))) for name, found in errors.items()}
    assert np.degrees(rms["wrist_pitch"]) == pytest.approx(5, rel=0.15)
    assert np.degrees(rms["jaw"]) == pytest.approx(7.5, rel=0.15)
    assert np.degrees(rms["roll"]) == pytest.approx(5, rel=0.15)
    assert np.degrees(rms["yaw"]) == pytest.approx(0.1, rel=0.1)
    assert 1e3 * rms["insertion"] == pytest.approx(0.4, rel=0.1)
    biases = np.mean(errors["wrist_yaw"], axis=1)
    assert np.degrees(biases.std()) == pytest.approx(5 * np.sqrt(0.8**2 + 0.6**2 / 4), rel=0.15)
    assert np.degrees(np.abs(biases).max()) > 8


# other instruments and cameras


def test_other_instrument_has_its_own_joints(shared: Path, tmp_path: Path) -> None:
    urdf = shared / "instruments" / "dvrk_model" / "urdf" / "instrument_400183.urdf"
    hook = Body.prepare(load_instrument(urdf))
    write_session(tmp_path / "hook", plan(hook, "clean", frames=1, markers={}), images=False)
    session = read_session(tmp_path / "hook", known=hook.instrument.joint_names)
    assert set(session.frames[0].readings) == {"yaw", "pitch", "insertion", "roll", *hook.instrument.joint_names}
    assert not (tmp_path / "hook" / "keypoints.csv").exists()


# the command


def test_command_writes_session_and_prints_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "s"
    line = ["synth", str(out), "--level", "easy", "--frames", "1", "--seed", "3", "--no-images"]
    assert main(line) == 0
    assert capsys.readouterr().out == f"1 frames, level easy, motion rcm, seed 3; written: {out}\n"
    entries = read_session_toml(out)
    assert [(tool.arm, tool.instrument, tool.kinematics) for tool in entries.tools] == [("PSM1", "lnd", "classic")]
    document = json.loads((out / "synth.json").read_text())
    assert (document["level"]["wrist_deg"], document["seed"], document["instrument"]) == (2.0, 3, "lnd")
    assert main(line) == 2
    assert capsys.readouterr().err.startswith(f"dvrk-cmaes: {out}: expected a new or empty folder")
    assert main([*line, "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--frames", "0"], "--frames: expected a whole number of at least 1, got 0"),
        (["--seed", "-1"], "--seed: expected a whole number of at least 0, got -1"),
    ],
)
def test_wrong_numbers_are_refused(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["synth", str(tmp_path / "s"), *arguments]) == 2
    assert capsys.readouterr().err == f"dvrk-cmaes: {expected}\n"
    assert not (tmp_path / "s").exists()


def test_instrument_without_shaft_is_refused(bundled_body: Body, tmp_path: Path) -> None:
    bare = Body(replace(bundled_body.instrument, shaft=None))
    with pytest.raises(InputError, match="lnd: expected an instrument with a straight shaft"):
        write_session(tmp_path / "s", plan(bare))
