"""Reasons to doubt a pose: readings that are far off, and views that contradict each other."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from helpers.frame_terms import SPREAD, readings_of, view_at
from helpers.places import ROOT
from helpers.transforms import apply, lookat_pose

from dvrk_cmaes import Body, Camera
from dvrk_cmaes.config import SessionConfig, TrustConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.doubts import RULES, Kind, Rule, doubts
from dvrk_cmaes.pose.judge import doubts_in_views, exchanged_readings, judge
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


def test_exchanged_readings_are_told_by_all_frames_of_a_recording_together(bundled_body: Body) -> None:
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


# the table


def beginnings(text: str, rule: Rule) -> list[str]:
    """How the reasons of a rule begin."""
    return rule.begins.split("|") if rule.begins else [re.split(r"[:{]", text)[0].strip()]


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


def test_every_rule_has_a_limit_a_text_and_a_kind() -> None:
    for text, rule in RULES.items():
        assert rule.of, text
        assert rule.limit is not None, text
        assert set(rule.holds.split()) <= set(get_args(Kind)), text
        assert rule.holds, text
        assert all(beginnings(text, rule)), text


def test_every_limit_that_is_a_setting_exists() -> None:
    for rule in RULES.values():
        for name in rule.limit.split() if isinstance(rule.limit, str) else ():
            if name.startswith("trust."):
                assert hasattr(TrustConfig(), name.removeprefix("trust.")), name


def test_pages_list_the_reasons_of_the_table_and_no_others() -> None:
    pages, begins = listed(), [one for text, rule in RULES.items() for one in beginnings(text, rule)]
    assert len(pages) > 40
    same = {(one, own) for one in pages for own in begins if one.startswith(own) or own.startswith(one)}
    assert set(pages) - {one for one, _ in same} == set()
    assert set(begins) - {own for _, own in same} == set()


def test_rule_that_does_not_hold_for_a_result_is_not_asked() -> None:
    assert doubts("agreement", "edges", misfit=0.0, config=SessionConfig()) == []
    (text,) = doubts("age", "live", age=1.5, oldest=1.0)
    assert text == "the image is 1.5 s old"
    assert doubts("age", "live", age=0.5, oldest=1.0) == doubts("age", "alone", age=1.5, oldest=1.0) == []
