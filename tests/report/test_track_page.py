"""The page of a followed recording: events, curves, figures and pictures."""

from __future__ import annotations

import json
import re
from dataclasses import replace

from helpers.page_calibrations import calibration, solved
from helpers.page_results import Page
from helpers.track_rows import recording, row

from dvrk_cmaes.report.template import rendered
from dvrk_cmaes.report.track_page import (
    FollowedRecording,
    track_charts,
    track_events,
    track_page,
)

LOST = "lost: the mask's edges do not support the predicted outline"
EVIL = "</script><script>document.title='taken'</script>\"'&<b>"


def page_of(followed: FollowedRecording) -> Page:
    return Page(rendered(track_page(followed)))


def test_losses_come_before_doubts_the_longest_first() -> None:
    statuses = ["ok", "lost", "lost", "lost", "doubtful", "ok", "doubtful", "lost"]
    rows = [row(k, status, *([LOST] if status == "lost" else [])) for k, status in enumerate(statuses)]
    rows[6]["reasons"] = ["uncertain: x"]
    found = [(event.status, event.first, event.frames, event.reason) for event in track_events(rows)]
    doubts = [("doubtful", 4, 1, ""), ("doubtful", 6, 1, "uncertain: x")]
    assert found == [("lost", 1, 3, LOST), ("lost", 7, 1, LOST), *doubts]
    assert page_of(recording(rows)).frames == ["0001", "0007", "0004", "0006"]
    assert track_events([row(0), row(1)]) == []


def test_page_says_why_frames_are_not_ok_and_leads_to_the_video() -> None:
    rows = [row(0), *(row(k, "doubtful", f"uncertain: tips within {k} mm") for k in (1, 2))]
    page = page_of(replace(recording(rows), video="tracks.mp4"))
    assert "Why frames are not ok 2 uncertain" in page.text
    assert "at 0.03 s: 2 frames, to 0002" in page.text
    assert "tracks.mp4" in page.addresses
    plain = page_of(recording([row(0)]))
    assert "followed in every frame" in plain.text
    assert "Why frames are not ok" not in plain.text
    assert "tracks.mp4" not in plain.addresses


def test_player_has_the_pictures_with_their_times() -> None:
    rows = [row(0), row(1, "lost", LOST), row(2, "lost", LOST), row(3)]
    html = rendered(track_page(recording(rows)))
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, flags=re.DOTALL)
    assert text is not None
    data = json.loads(text[1])
    assert (data["frames"], data["times"], data["statuses"]) == (["0000", "0003"], [0.0, 0.1], ["ok", "ok"])
    assert all(picture.startswith("data:image/webp") for picture in data["pictures"])


def test_page_has_the_base_before_the_places_and_one_colour_for_each_joint() -> None:
    followed = recording([row(0), row(1, "lost", LOST), row(2)])
    page = page_of(replace(followed, calibration=calibration(solved("ab"))))
    assert page.text.index("arm's base (RCM): position") < page.text.rindex("Places to look at, ")
    joints, offsets, *_ = track_charts(followed)
    colours = {curve.name: curve.colour for curve in joints.curves}
    own = {curve.name: curve.colour for curve in offsets.curves}
    assert len(set((colours | own).values())) == len(colours | own)
    assert {name: own[name] for name in colours} == colours


def test_texts_are_escaped() -> None:
    plain, odd = (page_of(recording([row(0, name=text), row(1, "lost", text)], session=text)) for text in ("x", EVIL))
    assert odd.tags == plain.tags


def test_recording_without_times_and_poses_has_a_page() -> None:
    page = page_of(recording([row(k, "lost", "no mask", time=None) for k in range(2)]))
    assert page.frames == ["0000"]
    assert "Lost once longest: 2 frames, from 0000" in page.text
