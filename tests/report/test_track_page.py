"""The page of a followed recording: events, curves, figures and pictures."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.page_results import Page
from helpers.track_rows import JOINTS, recording, row

from dvrk_cmaes.report.template import rendered
from dvrk_cmaes.report.track_page import (
    SWITCHED,
    FollowedRecording,
    TrackPictures,
    chosen_frames,
    track_charts,
    track_events,
    track_page,
    write_track_page,
)
from dvrk_cmaes.results.tracked import TrackView

LOST = "lost: the mask's edges do not support the predicted outline"
SWITCH = "switched to the mirror twin: it explains the images better"
EVIL = "</script><script>document.title='taken'</script>\"'&<b>"


def page_of(followed: FollowedRecording) -> Page:
    return Page(rendered(track_page(followed)))


def test_losses_come_before_doubts_and_switches_the_longest_first() -> None:
    statuses = ["ok", "lost", "lost", "gone", "doubtful", "ok", "doubtful", "lost"]
    rows = [row(k, status, *([LOST] if status == "lost" else [])) for k, status in enumerate(statuses)]
    rows[6]["reasons"] = ["uncertain: x", SWITCH]
    found = [(event.kind, event.first, event.frames, event.reason) for event in track_events(rows)]
    assert found == [("lost", 1, 3, LOST), ("lost", 7, 1, LOST), ("doubtful", 4, 1, ""), (SWITCHED, 6, 1, SWITCH)]
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


def test_curves_have_found_and_read_joints_in_degrees_and_speeds_without_gaps() -> None:
    rows = [row(0), row(1, "gone"), row(2), row(3)]
    read = {"jaw": np.array([0.0, np.nan, np.pi, 0.0])}
    charts = {chart.title: chart for chart in track_charts(replace(recording(rows), readings=read))}
    curves = {(curve.name, curve.faint): curve for curve in charts["Joints"].curves}
    assert set(curves) == {*((joint, False) for joint in JOINTS), ("jaw", True)}
    assert curves["jaw", True].colour == curves["jaw", False].colour
    np.testing.assert_allclose(curves["jaw", False].y, np.degrees([0.2, np.nan, 0.22, 0.23]))
    np.testing.assert_allclose(curves["jaw", True].y, [0, np.nan, 180, 0])
    np.testing.assert_allclose(charts["Speed of the tips"].curves[0].y, [np.nan, np.nan, np.nan, 30], rtol=1e-6)
    assert not charts["Keyframes"].known


def test_pictures_are_few_and_show_what_happened() -> None:
    rows = [row(k, "lost" if 500 <= k < 507 or k == 803 else "ok") for k in range(1000)]
    chosen = chosen_frames(rows, most=40)
    assert {0, 500, 803, 999} <= set(chosen)
    assert 35 <= len(chosen) <= 40
    restless = [row(k, "lost" if k % 2 else "ok") for k in range(1000)]
    assert len(chosen_frames(restless, most=40)) <= 40
    assert chosen_frames(rows[:30], most=40) == list(range(30))


def test_overlap_is_that_of_all_views_and_needs_masks() -> None:
    pictures = TrackPictures([row(0), row(1)])
    mask = np.zeros((48, 64), np.bool_)
    mask[10:30, 10:50] = True
    half = mask & (np.arange(64) < 30)
    pictures.add(0, [TrackView(np.full((48, 64, 3), 90, np.uint8), None, mask, (64, 48))])
    pictures.add(1, [TrackView(None, mask, mask, (64, 48)), TrackView(None, mask, half, (64, 48))])
    assert sorted(pictures.pictures) == [0, 1]
    assert pictures.overlaps == pytest.approx([np.nan, 0.75], nan_ok=True)


def test_player_has_the_pictures_with_their_times() -> None:
    rows = [row(0), row(1, "lost", LOST), row(2, "lost", LOST), row(3)]
    html = rendered(track_page(recording(rows)))
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, flags=re.DOTALL)
    assert text is not None
    data = json.loads(text[1])
    assert (data["frames"], data["times"], data["statuses"]) == (["0000", "0003"], [0.0, 0.1], ["ok", "ok"])
    assert all(picture.startswith("data:image/webp") for picture in data["pictures"])


def test_texts_are_escaped() -> None:
    plain, odd = (page_of(recording([row(0, name=text), row(1, "lost", text)], session=text)) for text in ("x", EVIL))
    assert odd.tags == plain.tags


def test_same_recording_gives_same_page(tmp_path: Path) -> None:
    rows = [row(k) for k in range(5)]
    first, second = (write_track_page(tmp_path / name, recording(rows)).read_bytes() for name in "ab")
    assert first == second


def test_recording_without_times_and_poses_has_a_page() -> None:
    page = page_of(recording([row(k, "gone", "no mask", time=None) for k in range(2)]))
    assert page.frames == ["0000"]
    assert "Lost once longest: 2 frames, from 0000" in page.text
