"""The page of a followed recording: events, curves, figures, pictures, and what is embedded."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from helpers.track_rows import JOINTS, recording, row

from dvrk_cmaes.report.plots.track import track_charts
from dvrk_cmaes.report.track_events import SWITCHED, track_events
from dvrk_cmaes.report.track_page import render_track_page, write_track_page
from dvrk_cmaes.report.track_pictures import TrackPictures, chosen_frames, contour_distances
from dvrk_cmaes.results.tracked import TrackView

LOST = "lost: the mask's edges do not support the predicted outline"
SWITCH = "switched to the mirror twin: it explains the images better"
EVIL = "</script><script>document.title='taken'</script>\"'&<b>"


def embedded(page: str) -> dict:
    text = re.search(r'<script type="application/json" id="recording">(.*?)</script>', page, flags=re.DOTALL)
    assert text is not None
    return json.loads(text[1])


def decoded(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


# events


def test_losses_and_switches_are_events() -> None:
    statuses = ["ok", "lost", "lost", "gone", "doubtful", "ok", "doubtful", "lost"]
    rows = [row(k, status, *([LOST] if status == "lost" else [])) for k, status in enumerate(statuses)]
    rows[6]["reasons"] = ["uncertain: x", SWITCH]
    found = [(event.kind, event.first, event.back, event.frames, event.reason) for event in track_events(rows)]
    assert found == [
        ("lost", 1, 4, 3, LOST),
        ("doubtful", 4, 5, 1, ""),
        (SWITCHED, 6, 6, 1, SWITCH),
        ("lost", 7, None, 1, LOST),
    ]


def test_doubtful_stretches_are_events() -> None:
    rows = [row(0), row(1, "doubtful", "uncertain: x"), row(2, "doubtful", "uncertain: y"), row(3), row(4, "doubtful")]
    found = [(event.kind, event.first, event.back, event.frames, event.reason) for event in track_events(rows)]
    assert found == [("doubtful", 1, 3, 2, "uncertain: x"), ("doubtful", 4, None, 1, "")]


def test_recording_of_ok_frames_has_no_events() -> None:
    assert track_events([row(0), row(1)]) == []


def test_page_counts_why_frames_are_not_ok_and_links_the_video() -> None:
    rows = [row(0), *(row(k, "doubtful", f"uncertain: tips within {k} mm") for k in (1, 2))]
    page = render_track_page(replace(recording(rows), video="tracks.mp4"))
    assert "Why frames are not ok" in page
    assert "<li><b>2</b> uncertain</li>" in page
    assert '<a href="tracks.mp4">' in page
    without = render_track_page(recording([row(0)]))
    assert "Why frames are not ok" not in without
    assert "tracks.mp4" not in without


def test_chart_that_ends_early_says_so() -> None:
    rows = [row(0), row(1), {**row(2), "offsets": {}}, {**row(3), "offsets": {}}]
    charts = {chart.name: chart for chart in track_charts(rows, None, {}, {})}
    assert charts["offsets"].note.endswith("Ends at 0001: not known in 2 later frames with a pose.")
    assert "Ends at" not in charts["joints"].note


def test_distance_of_a_contour_is_finer_than_a_pixel() -> None:
    rows, columns = np.mgrid[:200, :200]
    mask = columns * 0.2 + rows < 120
    shifted = columns * 0.2 + rows < 120.4
    found = contour_distances(mask, shifted)
    assert found is not None
    assert 0.2 < np.median(found) < 0.6


# curves


def test_curves_have_found_and_read_joints_in_degrees() -> None:
    rows = [row(0), row(1, "gone"), row(2)]
    read = {"jaw": np.array([0.0, np.nan, np.pi])}
    charts = {chart.name: chart for chart in track_charts(rows, np.array([0.0, 0.1, 0.3]), read, {})}
    assert set(charts) == {"joints", "offsets", "residual", "tips", "spread"}  # no speed across the gap
    (residual,) = charts["residual"].curves  # there are no masks
    np.testing.assert_allclose(residual.values, [0.8, np.nan, 0.8])
    curves = {(curve.name, curve.faint): curve for curve in charts["joints"].curves}
    assert set(curves) == {*((joint, False) for joint in JOINTS), ("read", True)}
    assert curves["read", True].colour == curves["jaw", False].colour
    np.testing.assert_allclose(curves["jaw", False].values, np.degrees([0.2, np.nan, 0.22]))
    np.testing.assert_allclose(curves["read", True].values, [0, np.nan, 180])
    np.testing.assert_allclose(charts["offsets"].curves[-1].values, np.degrees([0.05, np.nan, 0.05]))


def test_speed_is_that_of_the_mean_of_the_tips() -> None:
    rows = [row(0), row(2), row(3)]
    timed = next(chart for chart in track_charts(rows, np.array([0.0, 0.1, 0.2]), {}, {}) if chart.name == "speed")
    untimed = next(chart for chart in track_charts(rows, None, {}, {}) if chart.name == "speed")
    np.testing.assert_allclose(timed.curves[0].values, [np.nan, 20, 10])
    np.testing.assert_allclose(untimed.curves[0].values, [np.nan, 2, 1])
    assert ("mm/s" in timed.title, "mm a frame" in untimed.title) == (True, True)


# pictures and residuals


def test_pictures_are_few_and_show_what_happened() -> None:
    rows = [row(k, "lost" if 500 <= k < 507 or k == 803 else "ok") for k in range(1000)]
    chosen = chosen_frames(rows, most=40)
    assert {0, 500, 507, 803, 804, 999} <= set(chosen)
    assert 35 <= len(chosen) <= 40
    assert np.diff(chosen).max() < 40
    restless = [row(k, "lost" if k % 2 else "ok") for k in range(1000)]
    assert len(chosen_frames(restless, most=40)) <= 40
    assert chosen_frames(rows[:30], most=40) == list(range(30))


def test_residual_is_the_distance_of_the_contour_from_the_outline() -> None:
    silhouette = np.zeros((60, 80), np.bool_)
    silhouette[20:40, 20:60] = True
    larger = np.zeros_like(silhouette)
    larger[17:43, 17:63] = True
    found = contour_distances(larger, silhouette)
    assert found is not None
    assert np.median(found) == pytest.approx(3)
    assert contour_distances(silhouette, silhouette) == pytest.approx(0)
    assert contour_distances(silhouette, np.zeros_like(silhouette)) is None
    at_border = np.ones_like(silhouette)
    assert contour_distances(at_border, silhouette) is None


def test_frames_without_mask_have_a_picture_and_no_residual() -> None:
    rows = [row(0), row(1)]
    pictures = TrackPictures(rows)
    mask = np.zeros((48, 64), np.bool_)
    mask[10:30, 10:50] = True
    pictures.add(0, [TrackView(np.full((48, 64, 3), 90, np.uint8), None, mask, (64, 48))])
    pictures.add(1, [TrackView(None, mask, mask, (64, 48))])
    assert sorted(pictures.pictures) == [0, 1]
    np.testing.assert_allclose(pictures.residuals["median"], [np.nan, 0])


# the page


def test_embedded_values_are_those_of_the_recording() -> None:
    rows = [row(0), row(1, "lost", LOST), row(2, "lost", LOST), row(3)]
    data = embedded(render_track_page(recording(rows)))
    assert data["frames"] == ["0000", "0001", "0002", "0003"]
    np.testing.assert_allclose(decoded(data["times"]), np.arange(4) / 30, atol=1e-6)
    assert [data["statuses"][k] for k in base64.b64decode(data["status"])] == ["ok", "lost", "lost", "ok"]
    assert data["reasons"] == {"1": [0], "2": [0]}
    assert data["texts"] == [LOST]
    assert data["events"] == [["lost", 1, 3]]
    residual = data["charts"]["residual"]["curves"]
    np.testing.assert_allclose(decoded(residual[0]["values"]), np.linspace(0.5, 2, 4), rtol=1e-6)


def test_texts_are_escaped() -> None:
    rows = [row(0, name=EVIL), row(1, "lost", EVIL)]
    page = render_track_page(recording(rows, session=EVIL))
    scripts: list[dict[str, str | None]] = []

    class Tags(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            if tag == "script":
                scripts.append(dict(attrs))

    Tags().feed(page)
    assert scripts == [{"type": "application/json", "id": "recording"}, {}]
    assert embedded(page)["frames"][0] == EVIL
    assert "<b>" not in page.split("<main>")[0].split("<h1>")[1].replace('<p class="quiet"><b>', "")


def test_same_recording_gives_same_page(tmp_path: Path) -> None:
    rows = [row(k) for k in range(5)]
    first, second = (write_track_page(tmp_path / name, recording(rows)).read_bytes() for name in "ab")
    assert first == second


def test_recordings_of_odd_kinds_have_a_page() -> None:
    assert "followed in every frame" in render_track_page(recording([row(0)]))
    without = [row(k, "gone", "no mask", time=None) for k in range(2)]
    page = render_track_page(recording(without))
    assert embedded(page)["times"] is None
    assert "not again" in page
    assert "Modes switched" in page


def test_without_masks_the_residual_is_that_of_the_edges_used() -> None:
    whole = recording([row(0), row(1)])
    page = render_track_page(replace(whole, residuals={}))
    assert "Edges to outline, median" in page
    assert "Mask to outline" not in page
    assert "Mask to outline, median" in render_track_page(whole)
