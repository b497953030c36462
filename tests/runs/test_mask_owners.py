"""Recordings of two arms that are followed in one solution, and whose masks are named by the wrong arm."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from helpers.batch_sessions import QUICK_CONFIG
from helpers.session_worlds import make_frames_in_memory, write_folder
from helpers.shared_estimates import shared_estimates

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import Place
from dvrk_cmaes.calibration.together import Solving, solved_together
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.frames.packed_mask import overlap_of
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.results.track_files import TABLE, TRACKS, read_tracks
from dvrk_cmaes.runs.exchanged_tools import ArmInSession, with_masks_of
from dvrk_cmaes.runs.mask_owners import AmongArms, ArmsOfRecording, exchanged_frames
from dvrk_cmaes.runs.track_folder import TrackSummary, tracking_folder
from dvrk_cmaes.runs.track_frames import TrackSettings
from dvrk_cmaes.runs.track_pictures import seen_frames
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.truth import Truth

FRAMES = 12
SEEDS = {"PSM1": 5, "PSM2": 8}
QUICK = replace(QUICK_CONFIG, session=SessionConfig(rounds=2, cables=False, test_camera=False))
SETTINGS = TrackSettings(QUICK, evidence="masks", workers=1)


class TwoArms:
    """A recording of two arms of which each has a folder of masks."""

    def __init__(self, folder: Path) -> None:
        self.truths: dict[str, dict[str, Truth]] = {}
        self.arms: dict[str, ArmInSession] = {}
        for arm, seed in SEEDS.items():
            body = prepare("lnd")
            _, truths, frames = make_frames_in_memory(body, FRAMES, seed=seed)
            write_folder(folder / arm, frames)
            self.truths[arm] = dict(zip((frame.name for frame in frames), truths, strict=True))
            self.arms[arm] = ArmInSession(read_session(folder / arm), body, "classic")
        self.names = list(self.truths["PSM1"])

    def exchanged(self, names: Collection[str]) -> dict[str, ArmInSession]:
        """Return the arms with each other's masks in some frames."""
        given = {}
        for arm, other in (("PSM1", "PSM2"), ("PSM2", "PSM1")):
            own, masks = self.arms[arm], {files.name: files for files in self.arms[other].session.frames}
            frames = (with_masks_of(masks[f.name], f) if f.name in names else f for f in own.session.frames)
            given[arm] = replace(own, session=replace(own.session, frames=tuple(frames)))
        return given

    def errors_mm(self, out: Path) -> np.ndarray:
        """Return the mean errors (2, N) of the tips that were found."""
        found = []
        for arm, truths in self.truths.items():
            rows = read_tracks(out / arm / TRACKS)
            off = np.array([row["tips"] for row in rows]) - [truths[row["frame"]].tips for row in rows]
            found.append(1e3 * np.linalg.norm(off, axis=2).mean(axis=1))
        return np.array(found)


@pytest.fixture(scope="module", autouse=True)
def _estimated_once() -> Iterator[None]:
    """Let each keyframe be estimated once for all tests."""
    with shared_estimates():
        yield


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> TwoArms:
    return TwoArms(tmp_path_factory.mktemp("arms"))


def follow(
    arms: dict[str, ArmInSession],
    out: Path,
    given: dict[str, SessionCalibration] | None = None,
    *,
    stop: Event | None = None,
) -> tuple[dict[str, TrackSummary], list[str]]:
    """Follow both arms in one solution; also returns what was said of the first one.

    ``stop`` is set when the second arm's frames are left out one by one: the first arm waits for its solution then.
    """
    of_recording, said = ArmsOfRecording(arms), []

    def say(name: str, text: str) -> None:
        if name == "PSM1":
            said.append(text)
        elif stop is not None and text.startswith("leaving one out"):
            stop.set()

    def tracking(name: str, places: Sequence[Place]) -> Solving[TrackSummary]:
        settings = SETTINGS if given is None else replace(SETTINGS, calibration=given[name])
        among, notice = AmongArms(name, of_recording, places), partial(say, name)
        session, body = arms[name].session, arms[name].body
        return tracking_folder(
            session, out / name, body, settings, video=False, page=False, notice=notice, among=among, stop=stop
        )

    return solved_together({name: partial(tracking, name) for name in arms}), said


@pytest.fixture(scope="module")
def followed(world: TwoArms, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, TrackSummary]]:
    """The results of a recording in which each arm has the masks of the other in all frames."""
    out = tmp_path_factory.mktemp("exchanged")
    return out, follow(world.exchanged(world.names), out)[0]


def test_masks_that_are_exchanged_in_all_frames_are_followed_by_their_owners(
    world: TwoArms, followed: tuple[Path, dict[str, TrackSummary]]
) -> None:
    out, done = followed
    assert np.median(world.errors_mm(out)) < 1.5
    for arm, other in (("PSM1", "PSM2"), ("PSM2", "PSM1")):
        assert done[arm].counts.get("ok", 0) >= FRAMES // 2
        calibration = done[arm].calibration
        assert calibration is not None
        assert f"masks of this arm and {other} are exchanged in {FRAMES} of {FRAMES} frames" in calibration.remarks[-1]
        rows = read_tracks(out / arm / TRACKS)
        assert all(f"mask named as that of {other}, where the base expects this tool" in row["remarks"] for row in rows)


def same_tracks(out: Path, other: Path) -> bool:
    """Whether both arms have the same poses and remarks in two folders."""
    parts = [
        [(row["camera_from_root"], row["joints"], row["remarks"]) for row in read_tracks(folder / arm / TRACKS)]
        for folder in (out, other)
        for arm in SEEDS
    ]
    return parts[:2] == parts[2:] and all(parts)


def test_run_that_was_interrupted_at_the_second_arm_decides_by_both(
    world: TwoArms, followed: tuple[Path, dict[str, TrackSummary]], tmp_path: Path
) -> None:
    out, arms = tmp_path / "again", world.exchanged(world.names)
    shutil.copytree(followed[0], out)
    (out / "PSM2" / TABLE).unlink()
    follow(arms, out)
    assert same_tracks(out, followed[0])


def test_run_that_was_interrupted_while_one_arm_is_solved_leaves_no_solution(world: TwoArms, tmp_path: Path) -> None:
    stop = Event()
    done, _ = follow(world.arms, tmp_path, stop=stop)
    assert stop.is_set()
    assert all(own.interrupted for own in done.values())
    assert not list(tmp_path.glob("*/keyframes.json"))


def test_solution_that_only_one_arm_has_is_used_beside_a_new_one(
    world: TwoArms, followed: tuple[Path, dict[str, TrackSummary]], tmp_path: Path
) -> None:
    out, arms = tmp_path / "again", world.exchanged(world.names)
    shutil.copytree(followed[0], out)
    for path in (out / "PSM1" / TABLE, out / "PSM2" / TABLE, out / "PSM2" / "keyframes.json"):
        path.unlink()
    follow(arms, out)
    assert np.median(world.errors_mm(out)) < 1.5
    assert all("mask named as that of PSM1" in " ".join(row["remarks"]) for row in read_tracks(out / "PSM2" / TRACKS))


def test_pictures_show_the_masks_by_which_frames_were_followed(
    world: TwoArms, followed: tuple[Path, dict[str, TrackSummary]]
) -> None:
    arms = world.exchanged(world.names)
    of_recording = ArmsOfRecording(arms)
    for arm, own in followed[1].items():
        frames = of_recording.as_followed(arms[arm].session.frames, own.rows)
        assert [files.mask for files in frames] == [files.mask for files in world.arms[arm].session.frames]
        for seen in seen_frames(frames, own.rows, arms[arm].session.rig, arms[arm].body):
            (view,) = seen.views
            assert view.mask is not None
            assert view.silhouette is not None
            assert overlap_of(view.mask, view.silhouette) > 0.8


def test_masks_that_are_exchanged_in_some_frames_are_followed_by_their_owners(
    world: TwoArms, followed: tuple[Path, dict[str, TrackSummary]], tmp_path: Path
) -> None:
    found = {arm: own.calibration for arm, own in followed[1].items()}
    given = {arm: replace(own, remarks=()) for arm, own in found.items() if own is not None}
    wrong = world.names[4:7]
    assert exchanged_frames(world.arms, given, QUICK) == []
    (text,) = exchanged_frames(world.exchanged(wrong), given, QUICK)
    assert text.startswith(f"the masks of PSM1 and PSM2 are exchanged in 3 of {FRAMES} frames ({', '.join(wrong)})")
    right, _ = follow(world.arms, tmp_path / "right", given)
    done, _ = follow(world.exchanged(wrong), tmp_path / "some", given)
    np.testing.assert_allclose(world.errors_mm(tmp_path / "some"), world.errors_mm(tmp_path / "right"), atol=1e-6)
    for arm in SEEDS:
        same = right[arm].calibration
        assert same is not None
        assert same.remarks == ()
        rows = read_tracks(tmp_path / "some" / arm / TRACKS)
        noted = [row["frame"] for row in rows if any("mask named as that of" in text for text in row["remarks"])]
        assert noted == wrong
        calibration = done[arm].calibration
        assert calibration is not None
        assert f"({', '.join(wrong)})" in calibration.remarks[-1]
