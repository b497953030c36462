"""Reasons to doubt a pose: readings that are far off, and views that contradict each other."""

from __future__ import annotations

import inspect
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.frame_terms import SPREAD, readings_of, view_at
from helpers.places import ROOT
from helpers.transforms import apply, lookat_pose

from dvrk_cmaes import Body, Camera, prepare
from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.interpolation import Sparseness
from dvrk_cmaes.pose import doubts
from dvrk_cmaes.pose.doubts import LIMITS, NO_OUTER_READINGS, NO_READINGS, NOT_FOUND
from dvrk_cmaes.pose.expected_error import tip_probability
from dvrk_cmaes.pose.judge import doubts_in_views, exchanged_readings, jaw_end_missing, judge
from dvrk_cmaes.pose.refine.gauss_newton import Fit
from dvrk_cmaes.results.result import ExpectedError, Quality, ViewCheck

CAMERA = Camera(320, 240, 440, 440, 160, 120)
TRUE = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5]))
GOOD = Quality(0.97, 0.1, {}, 0.5, 1.5, distal_px=0.8)
EXPECTED = ExpectedError({"mean": 0.3}, {}, 0.5, 0.4)


def reasons_of(body: Body, *, sigmas: tuple[float, ...] = (0, 0, 0), turn: float = 0.0, std: float = 0.01) -> list[str]:
    """Give the reasons to doubt the true pose in two views.

    The readings are so many standard deviations off; the right view fits with a turn, degrees, known to ``std``.
    """
    views = [view_at(body, CAMERA, TRUE)] * 2
    rotation = np.array([turn, 0.0, 0.0])
    checks = [
        ViewCheck("left", GOOD, np.zeros(3), np.zeros((3, 3))),
        ViewCheck("right", GOOD, rotation, std**2 * np.eye(3)),
    ]
    readings = readings_of(body, TRUE.joints + np.array(sigmas) * SPREAD)
    fits = [Fit(TRUE, 0.0, 0.0, np.eye(9), None, TRUE)]
    return judge(fits, views, checks, EXPECTED, 0.99, readings, TrustConfig())[0]


def test_pose_near_its_readings_is_not_doubted(bundled_body: Body) -> None:
    assert reasons_of(bundled_body, sigmas=(1, -1, 1)) == []


def test_one_joint_far_from_its_reading_is_named(bundled_body: Body) -> None:
    (reason,) = reasons_of(bundled_body, sigmas=(0, 3, 0))
    assert reason == "far from the readings: wrist_yaw is 3.0 times the expected error away"


def test_joints_that_are_off_together_are_doubted_although_none_is_far_alone(bundled_body: Body) -> None:
    (reason,) = reasons_of(bundled_body, sigmas=(2, -2, 2))
    assert reason == "far from the readings: all joints together are farther off than readings are"


@pytest.mark.parametrize(("exchanged", "remarks"), [(True, 1), (False, 0)])
def test_exchanged_readings_of_the_wrist_have_a_remark(bundled_body: Body, exchanged: bool, remarks: int) -> None:
    read = TRUE.joints[[1, 0, 2]] if exchanged else TRUE.joints + 0.1
    found = exchanged_readings(TRUE.joints[None], read[None], bundled_body.instrument)
    assert len(found) == remarks
    assert all(
        "wrist_pitch and wrist_yaw may be exchanged: found 23 and -17 deg, read -17 and 23" in one for one in found
    )


def test_exchanged_readings_are_found_by_all_frames_of_a_recording_together(bundled_body: Body) -> None:
    """Frames in which both joints read the same tell nothing by themselves."""
    found = np.radians([[20.0, 25.0, 10.0], [-40.0, 17.0, 10.0], [30.0, -5.0, 10.0]])
    read = found[:, [1, 0, 2]] + np.radians(4.0)
    assert exchanged_readings(found[:1], read[:1], bundled_body.instrument) == []
    (remark,) = exchanged_readings(found, read, bundled_body.instrument)
    assert "found -40 and 17 deg, read 21 and -36" in remark
    assert exchanged_readings(found, found + np.radians(4.0), bundled_body.instrument) == []
    assert exchanged_readings(found, np.full_like(found, np.nan), bundled_body.instrument) == []


def doubts_followed(body: Body, camera: Camera, quality: Quality, *, followed: bool) -> list[str]:
    """Give the reasons to doubt the true pose of that quality, with or without the support of neighbouring images."""
    views = [view_at(body, camera, TRUE)]
    return doubts_in_views(TRUE, views, [quality], EXPECTED, TrustConfig(), "followed" if followed else "alone")[0]


@pytest.mark.parametrize(("px", "alone", "followed"), [(2.7, 0, 0), (4.0, 1, 0), (4.4, 1, 1)])
def test_contour_beyond_the_shaft_may_be_farther_off_with_neighbouring_images(
    bundled_body: Body, px: float, alone: int, followed: int
) -> None:
    quality = replace(GOOD, distal_px=px)
    assert len(doubts_followed(bundled_body, CAMERA, quality, followed=False)) == alone
    assert len(doubts_followed(bundled_body, CAMERA, quality, followed=True)) == followed


@pytest.mark.parametrize(("tips", "alone", "followed"), [(0, 0, 0), (1, 1, 0), (2, 1, 1)], ids=["none", "one", "both"])
def test_tips_outside_the_image_are_doubted_both_together_with_neighbouring_images(
    bundled_body: Body, tips: int, alone: int, followed: int
) -> None:
    ends = np.sort(CAMERA.project(apply(TRUE.pose, bundled_body.instrument.tips(TRUE.joints)))[:, 0])
    shift = CAMERA.width - 0.5 - [ends[1] + 2, ends.mean(), ends[0] - 2][tips]  # to the image's right edge
    camera = replace(CAMERA, cx=CAMERA.cx + shift)
    alone_says, followed_says = (doubts_followed(bundled_body, camera, GOOD, followed=each) for each in (False, True))
    assert [text.split(":")[0] for text in alone_says] == ["tip out of view"] * alone
    assert [text.split(":")[0] for text in followed_says] == ["tip out of view"] * followed


@pytest.mark.parametrize(
    ("turn", "std", "disagree"),
    [(0.5, 0.02, True), (0.5, 0.4, False), (0.05, 0.002, False), (0.0, 0.01, False)],
    ids=["large and certain", "large but uncertain", "certain but small", "none"],
)
def test_views_disagree_by_a_rotation_that_is_large_and_certain(
    bundled_body: Body, turn: float, std: float, disagree: bool
) -> None:
    reasons = reasons_of(bundled_body, turn=turn, std=std)
    assert [reason.split(":")[0] for reason in reasons] == ["views disagree"] * disagree


def test_jaws_with_openings_are_not_taken_for_cut_off() -> None:
    open_jaws = Posed(TRUE.pose, np.radians([0.0, 0.0, 30.0]))
    assert not jaw_end_missing(view_at(prepare("prograsp"), CAMERA, open_jaws), open_jaws)


# every reason, by a call that gives it and one that does not


TRUST = TrustConfig()
ACCURATE, INACCURATE = EXPECTED, ExpectedError({"mean": 5.0}, {}, 5.0, 0.4)
BASE = (*("base known to 1.2 mm", "base_uncertain"), (1.2, 9, 3.0, 2.0), (1.2, 9, 1.0, 2.0))
SPARSE = Sparseness(np.zeros(4), 0.01, "every 100 ms"), Sparseness()
EXAMPLES: list[tuple[str, str, tuple[Any, ...], tuple[Any, ...]]] = [
    ("overlap too low", "overlap_too_low", (GOOD, 0.98), (GOOD, 0.96)),
    ("wrist or jaws off", "wrist_or_jaws_off", (GOOD, 0.7), (GOOD, 0.9)),
    ("mask cut straight", "mask_cut_straight", (replace(GOOD, bend_px=9.0), 8.0), (GOOD, 8.0)),
    ("tip out of view", "tip_out_of_view", (LIMITS["alone"], (True, False)), (LIMITS["followed"], (True, False))),
    ("tips not accurate", "tips_not_accurate", (INACCURATE, TRUST), (ACCURATE, TRUST)),
    ("views disagree", "view_mirrored", ("right", "left", 0.7), ("right", "left", 0.5)),
    ("views disagree", "view_turned", ("right", "left", 2.0, 9.0, TRUST), ("right", "left", 2.0, 0.1, TRUST)),
    ("views disagree", "rig_turned", ("right", 8, 2.0, 9.0, TRUST), ("right", 8, 0.01, 9.0, TRUST)),
    ("mode in doubt", "mode_in_doubt", (ACCURATE, 0.6, "its twin", TRUST), (ACCURATE, 1.0, "its twin", TRUST)),
    ("readings against outline", "readings_against_outline", (1e6, TRUST), (0.0, TRUST)),
    ("far from the readings", "far_from_readings", (["jaw"], [9.0], TRUST), (["jaw"], [np.nan], TRUST)),
    ("shaft not found", "shaft_not_found", (False,), (True,)),
    ("points", "points_off", (9.0, 8.0), (7.0, 8.0)),
    ("mask is a guess", "mask_is_a_guess", (0.4, 0.5), (0.6, 0.5)),
    ("base far from the others'", "base_apart", (20.0, 10.0), (9.0, 10.0)),
    ("mask not explained", "mask_not_explained", (GOOD, 0.98, 3.5), (GOOD, 0.9, 3.5)),
    ("disagrees with the session", "pose_not_expected", (LIMITS["solved"], np.nan, 4.0), (LIMITS["solved"], 1.0, 4.0)),
    (
        "disagrees with the recording",
        "pose_not_expected",
        (LIMITS["followed"], 9.0, 4.0),
        (LIMITS["followed"], 1.0, 4.0),
    ),
    ("disagrees with the session", "frame_disagrees", (9.0, 4.0, None), (1.0, 4.0, None)),
    ("disagrees with the session", "frame_disagrees", (1.0, 4.0, (0.5, 0.9)), (1.0, 4.0, None)),
    ("reading of", "reading_slipped", ("jaw", 20.0, 5.0), ("jaw", 20.0, 3.0)),
    ("lost", "pose_lost", ("mask", None), ("mask", 0.6)),
    ("lost", "pose_lost", ("mask", 0.4), ("mask", 0.6)),
    ("40 % of the silhouette", "silhouette_without_colours", (0.4,), (0.2,)),
    ("joints far from the recording", "joints_far_from_recording", ("jaw", 9.0, 3.0), ("jaw", 9.0, 1.0)),
    ("no readings", "readings_missing", (False, False, "mask"), (True, False, "mask")),
    ("readings stand still", "readings_missing", (True, True, "mask"), (True, False, "mask")),
    ("readings too sparse", "readings_too_sparse", (SPARSE[0],), (SPARSE[1],)),
    ("readings frozen since frame 7", "readings_frozen", ("7",), ("",)),
    ("calibration contradicted", "calibration_contradicted", (10,), (9,)),
    ("too few keyframes to rely on", "too_few_keyframes", (1.2, 7), (1.2, 8)),
    BASE,
    ("black image", "image_black", (3, 4), (5, 4)),
    ("no mask", "mask_says_nothing", (False, False, False), (True, True, True)),
    ("empty mask", "mask_says_nothing", (True, False, True), (True, True, True)),
    ("full mask", "mask_says_nothing", (True, True, False), (True, True, True)),
    ("frozen image", "image_frozen", ("mask", True), ("mask", False)),
    ("the image is 1.5 s old", "image_old", (1.5, 1.0), (0.5, 1.0)),
]
FIXED = (
    NO_READINGS,
    NO_OUTER_READINGS,
    NOT_FOUND,
    doubts.base_not_known(3, ""),
    doubts.search_running(1.0),
    "tips in doubt",
)
OF_SESSIONS = (
    "this calibration predicts frames badly",
    "only N of M frames agree",
    "the lag leaves",
    "the shaft is",
    "the length from the wrist",
    "the jaws are",
    "all of it is",
    "the ends of the jaws are missing from the masks",
    "camera file: most likely wrong",
    "the camera file is contradicted",
    "offset of",
    "lag between images and readings",
    "session",
)
"""The beginnings of what `calibration.session_doubts` returns, whose tests are in test_session_doubts.py."""


def texts(found: str | list[str] | None) -> list[str]:
    return found if isinstance(found, list) else [] if found is None else [found]


@pytest.mark.parametrize(("begins", "name", "doubtful", "good"), EXAMPLES)
def test_reason_is_given_beyond_its_limit_alone(
    begins: str, name: str, doubtful: tuple[Any, ...], good: tuple[Any, ...]
) -> None:
    judge_by = getattr(doubts, name)
    (text,) = texts(judge_by(*doubtful))
    assert text.startswith(begins)
    assert texts(judge_by(*good)) == []


@pytest.mark.parametrize(("of_mode", "begins"), [(0.98, "tips in doubt"), (0.9, "mode in doubt")])
def test_mode_is_named_where_it_makes_the_tips_doubtful(of_mode: float, begins: str) -> None:
    trust = replace(TRUST, least_probability=tip_probability(0.5, TRUST.tip_mm))
    assert str(doubts.mode_in_doubt(EXPECTED, of_mode, "its twin", trust)).startswith(begins)


def test_every_function_that_judges_has_an_example() -> None:
    judging = {
        name
        for name, function in inspect.getmembers(doubts, inspect.isfunction)
        if function.__module__ == doubts.__name__ and function.__annotations__["return"] in ("str | None", "list[str]")
    }
    assert judging - {"reasons"} == {name for _, name, _, _ in EXAMPLES}


def listed() -> list[str]:
    """The beginnings of reasons that the reference pages list, in the first columns of their tables."""
    sections = {
        "problems": ("A frame is doubtful", "A recording is lost or stays doubtful"),
        "tracking": ("Doubts and losses",),
        "sessions": ("Remarks and doubts",),
    }
    cells = []
    for page, titles in sections.items():
        text = (ROOT / "data" / "reference" / f"{page}.md").read_text(encoding="utf-8")
        for title in titles:
            cells += re.findall(r"^\| (.*?) \|", text.split(f"\n## {title}\n")[1].split("\n## ")[0], re.MULTILINE)
    return [words for cell in cells for words in re.findall("`([^`]+)`", cell) if not words.startswith("--")]


def test_pages_list_the_reasons_that_are_given_and_no_others() -> None:
    given = [text for _, name, doubtful, _ in EXAMPLES for text in texts(getattr(doubts, name)(*doubtful))]
    begins = [re.split(r"[:0-9]", text)[0].strip() for text in (*given, *texts(list(FIXED)), *OF_SESSIONS)]
    pages = listed()
    assert len(pages) > 40
    assert [one for one in pages if not any(matches(one, own) for own in begins)] == []
    assert [own for own in begins if not any(matches(one, own) for one in pages)] == []


def matches(listed: str, own: str) -> bool:
    return listed.startswith(own) or own.startswith(listed)
