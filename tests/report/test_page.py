"""The page of a session's results: its contents and order, and the escaping of names and texts."""

from __future__ import annotations

import base64
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.page_results import doubtful, failed, overlay, page_of, result, write_results
from hypothesis import given
from hypothesis import strategies as st

from dvrk_cmaes.draw.canvas import DARK
from dvrk_cmaes.draw.panels import MASK, SILHOUETTE, footer, header
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import exp_rotation, transform
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.report.page import write_page
from dvrk_cmaes.report.page_scene import scene_of
from dvrk_cmaes.report.page_session import (
    FrameBases,
    common_warnings,
    counted_reasons,
    joint_summaries,
    provenances,
    reason_kind,
)
from dvrk_cmaes.report.page_thumbnails import LARGEST, WIDTH, Thumbnail, thumbnail
from dvrk_cmaes.report.plots.axes import name_axis, round_step, value_axis
from dvrk_cmaes.report.plots.panels import joint_plot, rcm_plot
from dvrk_cmaes.report.plots.tips import speed_plot, tips_plot
from dvrk_cmaes.results.result import Result

WEBP = "data:image/webp;base64,"


def pixels_of(small: Thumbnail | None) -> np.ndarray:
    assert small is not None
    data = base64.b64decode(small.address.removeprefix(WEBP))
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def at_rcm(name: str, *millimetres: float) -> Result:
    return result(name, camera_from_base=transform(np.eye(3), np.array(millimetres) / 1e3))


def test_page_is_report_html(tmp_path: Path) -> None:
    assert write_page(write_results(tmp_path, [result("a")])) == tmp_path / "report.html"


def test_page_refers_to_own_folder_only(tmp_path: Path) -> None:
    addresses = page_of(write_results(tmp_path, [result("a"), failed("b")])).addresses
    outside = [address for address in addresses if not re.match(r"data:|#|overlays/|frames/", address)]
    assert outside == []
    assert {"overlays/a.jpg", "overlays/b.jpg", "frames/a.json", "frames/b.json"} <= set(addresses)


def test_page_is_reproducible(tmp_path: Path) -> None:
    frames = [result("a"), doubtful("b", "far from the readings: jaw"), failed("c")]
    first = write_page(write_results(tmp_path / "one", frames)).read_bytes()
    second = write_page(write_results(tmp_path / "two", reversed(frames))).read_bytes()
    assert first == second


def test_frames_are_sorted_by_doubt(tmp_path: Path) -> None:
    frames = [
        result("fine"),
        doubtful("one reason", "a: x"),
        doubtful("two reasons", "a: x", "b: y", iou=0.95),
        doubtful("one reason, less overlap", "a: x", iou=0.8),
        failed("no pose"),
    ]
    expected = ["no pose", "two reasons", "one reason, less overlap", "one reason", "fine"]
    assert page_of(write_results(tmp_path, frames)).frames == expected


@pytest.mark.parametrize(
    "name", ["<script>alert(1)<script>", "\"double\" & 'single'", "größe 7 {{ 7*7 }}", "a#b?c%d", "--><details open>"]
)
def test_frame_names_are_escaped(tmp_path: Path, name: str) -> None:
    plain, odd = (page_of(write_results(tmp_path / str(k), [result(n)])) for k, n in enumerate(["plain", name]))
    assert odd.frames == [name]
    assert odd.tags == plain.tags


def test_texts_of_results_are_escaped(tmp_path: Path) -> None:
    words = ("<img src=x onerror=alert(1)>", "</script><b>", "&amp;")
    one = result("a", status="doubtful", reasons=words, warnings=words, instrument="<i>", version="<u>")
    page = page_of(write_results(tmp_path, [one]))
    assert not {"b", "i", "u"} & set(page.tags[page.tags.index("article") :])
    for text in words:
        assert text in page.text


def test_details_of_frame(tmp_path: Path) -> None:
    one = result(
        "a",
        status="doubtful",
        reasons=("twin undecided: why",),
        warnings=("intrinsics rescaled by 2",),
        unused=("no shaft edges: too short",),
        source="session",
        change={"translation_mm": 1.25, "rotation_deg": 2.5, "joints_deg": {"jaw": -3.0}},
    )
    text = page_of(write_results(tmp_path, [one])).text
    for part in (
        "roll_link: position, mm 10.00 -20.00 100.00",
        "standard deviation along its own axes, mm 1.00 2.00 3.00",
        "standard deviation about its own axes, deg 0.57 1.15 1.72",
        "wrist_pitch, deg 28.65 2.29 22.92 +5.73",
        "insertion, mm 150.00",
        "arm's base (RCM): position, mm 60.00 -70.00 50.00",
        "twin undecided: why",
        "intrinsics rescaled by 2",
        "no shaft edges: too short",
        "mirror twin 0.9550 0.1 41.5 0.0 0.0 wrist_pitch -28.6 deg",
        "1.50 s, 1,301 silhouettes, 3,210 rays",
        "with the session's frames",
        "translation, mm: 1.25; rotation, deg: 2.50; joints, deg: jaw -3.00",
    ):
        assert part in text


def test_summary_of_session(tmp_path: Path) -> None:
    frames = [at_rcm("a", 50, 0, 0), at_rcm("b", 53, 0, 0), at_rcm("c", 47, 0, 0), doubtful("d", "x: y"), failed("e")]
    frames[3] = replace(frames[3], camera_from_base=transform(exp_rotation([0, 0, 0.5]), [0.05, 0, 0]), seconds=2.5)
    text = page_of(write_results(tmp_path, frames)).text
    for part in (
        "5 frames of lnd · dvrk-cmaes 1.2.3",
        "3 ✓ ok 1 ? doubtful 1 ✕ failed",
        "Overlap (IoU), median 0.960 lowest 0.900 (d)",
        "Outline to mask, median 0.6 px 95 % of it within 2.1 px, in the worst frame 6.0 px",
        "Time a frame, median 1.50 s slowest 2.50 s",
        "RCM, spread (rms) 2.1 mm half of 4 frames within 1.5 mm of the median",
        "Arm's base, rotation 0.0° median from the most central frame, at most 28.6°",
        "Each frame was solved by itself",
    ):
        assert part in text


def test_joint_calibration_is_stated(tmp_path: Path) -> None:
    frames = [result(name, source="session") for name in "abc"]
    text = page_of(write_results(tmp_path, frames)).text
    assert "All frames were solved together with their session: how well they agree says nothing about" in text
    assert "a check that needs no truth" not in text


def test_batch_summary_is_shown(tmp_path: Path) -> None:
    summary = {"session": "/data/pig 3", "missing": ["x", "y"], "timing": {"run": {"frames": 1, "seconds": 754.2}}}
    write_json(write_results(tmp_path, [result("a")]) / "summary.json", summary)
    text = page_of(tmp_path).text
    assert "pig 3 ·" in text
    assert "2 more frames have no result yet." in text
    assert "slowest 1.50 s; 1 frame in 12 min 34 s" in text


def test_minimal_result_is_shown(tmp_path: Path) -> None:
    pose = [[1, 0, 0, 0.01], [0, 1, 0, 0.02], [0, 0, 1, 0.1], [0, 0, 0, 1]]
    write_json(tmp_path / "0001.json", {"camera_from_root": pose, "joints": {"jaw": 0.5}, "seconds": 600.0})
    page = page_of(tmp_path)
    assert "no picture" in page.text
    assert "jaw, deg 28.65 - - -" in page.text
    assert "svg" not in page.tags[page.tags.index("article") :]


def test_frame_name_does_not_lead_out_of_folder(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "secret.jpg"), np.zeros((30, 40, 3), np.uint8))
    out = write_results(tmp_path / "out", [result("a")])
    document = json.loads((out / "frames" / "a.json").read_text())
    write_json(out / "frames" / "a.json", document | {"frame": "../../secret"})
    page = page_of(out)
    assert page.frames == ["../../secret"]
    assert not [address for address in page.addresses if "secret" in address and not address.startswith("#")]


def test_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected results, frames/FRAME\.json or FRAME\.json, got none"):
        write_page(tmp_path)
    assert not list(tmp_path.iterdir())


def test_thumbnails_are_small_and_without_text_strips(tmp_path: Path) -> None:
    one = doubtful("a", "reason: one", "reason: two")
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), overlay(one, 1280))
    small = thumbnail(path, one)
    assert small is not None
    assert len(base64.b64decode(small.address.removeprefix(WEBP))) <= LARGEST
    assert (small.width, small.height) == (WIDTH, WIDTH * 3 // 4)
    assert pixels_of(small).shape == (small.height, small.width, 3)


def test_thumbnail_shows_region_of_outlines(tmp_path: Path) -> None:
    one = result("a")
    picture = np.full((960, 1280, 3), DARK, np.uint8)
    cv2.rectangle(picture, (100, 600), (560, 900), SILHOUETTE, 4)
    cv2.rectangle(picture, (104, 604), (564, 904), MASK, 4)
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), np.concatenate([header(one, 1280, 1.0), picture, footer(one, 1280, 1.0)]))
    bright = pixels_of(thumbnail(path, one)).max(axis=2) > 100
    v, u = np.nonzero(bright)
    assert 0.8 * WIDTH < u.max() - u.min() < 0.95 * WIDTH
    assert v.max() < WIDTH * 3 / 4 - 4


@pytest.mark.parametrize("content", [b"", b"\xff\xd8\xff\xe0 not a picture"])
def test_damaged_overlay_is_left_out(tmp_path: Path, content: bytes) -> None:
    write_results(tmp_path, [result("a")])
    (tmp_path / "overlays" / "a.jpg").write_bytes(content)
    page = page_of(tmp_path)
    assert "no picture" in page.text
    assert "overlays/a.jpg" not in page.addresses


def test_reasons_are_counted_once_per_frame() -> None:
    frames = [doubtful("a", "far: jaw", "far: yaw"), doubtful("b", "far: jaw", "twin undecided: x"), result("c")]
    assert counted_reasons([frame.reasons for frame in frames]) == [("far", 2), ("twin undecided", 1)]


@pytest.mark.parametrize(
    ("reason", "kind"),
    [
        ("masks/0005.png: mask is empty: expected pixels above 127, got none", "mask is empty"),
        ("/data/a b/masks/7.jpg: mask is full: expected background, got none", "mask is full"),
        ("images/0010.jpg: no instrument found in the image; a mask would help", "no instrument found in the image"),
        ("masks/1.png: expected a mask, got something else", "expected a mask, got something else"),
        ("joints.csv:12: roll: expected a finite number, got 'x'", "roll: expected a finite number"),
        (
            "joints.csv: frame 0007: jaw: expected readings before and after the image's time 3.500 s, got none",
            "jaw: expected readings before and after the image's time",
        ),
        ("out of memory: try fewer workers", "out of memory"),
        ("readings far off: jaw by 40 deg", "readings far off"),
        ("gave up after 600 s", "gave up after 600 s"),
    ],
)
def test_kind_of_reason_has_no_path_and_no_numbers(reason: str, kind: str) -> None:
    assert reason_kind(reason) == kind
    assert kind in reason  # the page finds frames by it


def test_failed_frames_of_one_reason_have_one_chip(tmp_path: Path) -> None:
    frames = [failed(f"{k:04d}", f"masks/{k:04d}.png: mask is empty: expected pixels, got none") for k in range(3)]
    page = page_of(write_results(tmp_path, [*frames, result("a")]))
    assert "Why frames are not ok 3 mask is empty Plots" in page.text.replace("  ", " ")
    assert page.text.count("mask is empty") == 1 + 2 * 3  # on the chip, and on each card and in its details
    assert {f"overlays/{k:04d}.jpg" for k in range(3)} <= set(page.addresses)


def test_common_warning_is_shown_once() -> None:
    frames = [result("a", warnings=("rescaled", "hot")), result("b", warnings=("rescaled",))]
    assert common_warnings(frames) == ["rescaled"]
    assert common_warnings(frames[:1]) == []


def test_provenances_are_distinguished() -> None:
    frames = [result("a"), result("b"), result("c", seed=7)]
    assert [(origin.frames, origin.seed) for origin in provenances(frames)] == [(2, 0), (1, 7)]


def test_joint_corrections_are_summarised_in_degrees() -> None:
    read = [{"wrist_pitch": 0.5 - math.radians(off)} for off in (1, 2, 9)]
    (summary,) = joint_summaries([result(f"{k}", readings=readings) for k, readings in enumerate(read)])
    assert (summary.joint, summary.frames, summary.frame) == ("wrist_pitch", 3, "2")
    assert [summary.median, summary.half_within, summary.largest] == pytest.approx([2, 1, 9])
    assert summary.std == pytest.approx(math.degrees(0.04))


def test_joint_plot_positions_agree_with_axis() -> None:
    frames = [result("a"), doubtful("b", "x: y"), result("c", readings={})]
    plot = joint_plot(frames)
    assert plot is not None
    (panel,) = plot.panels
    assert [series.name for series in panel.series] == ["wrist_pitch", "wrist_yaw", "jaw"]
    for series in panel.series:
        assert [(mark.place, mark.sure) for mark in series.marks] == [(0, True), (1, False)]
        assert [mark.y for mark in series.marks] == pytest.approx([panel.up.at(math.degrees(0.1))] * 2)
        assert len(series.bars) == 2


def test_plots_are_over_time_where_it_is_known() -> None:
    frames = [result("a", time=10.0), result("b", time=10.5), result("c", time=12.0)]
    tips = (np.array([0.0, 0.0, 0.1]), np.array([0.002, 0.0, 0.1]))
    frames = [replace(one, tips=tuple(np.add(tip, [k / 1e3, 0, 0]) for tip in tips)) for k, one in enumerate(frames)]
    for plot in (joint_plot(frames), tips_plot(frames)):
        assert plot is not None
        (panel,) = plot.panels
        assert panel.across.label == "time from the first image, s"
        middle = np.mean([[mark.x for mark in series.marks] for series in panel.series], axis=0)
        assert middle - middle[0] == pytest.approx([panel.across.at(t) - panel.across.at(0) for t in (0, 0.5, 2)])
    unknown = joint_plot([*frames[:2], result("c")])
    assert unknown is not None
    assert unknown.panels[0].across.label == "frame"


def test_tips_plot_is_from_median_in_millimetres() -> None:
    frames = [result(f"{k}", tips=(np.array([0.001 * k, 0.0, 0.1 + 0.002 * k]),)) for k in range(3)]
    plot = tips_plot([*frames, failed("x")])
    assert plot is not None
    up = plot.panels[0].up
    for series, off in zip(plot.panels[0].series, ([-1, 0, 1], [0, 0, 0], [-2, 0, 2]), strict=True):
        assert [mark.y for mark in series.marks] == pytest.approx([up.at(value) for value in off])
    assert tips_plot(frames[:1]) is None


def test_axes_of_the_tips_plot_have_the_colours_of_the_overlay() -> None:
    plot = tips_plot([result(name, tips=(np.array([0.0, 0.0, 0.1]),)) for name in "ab"])
    assert plot is not None
    vermillion, green, blue = 1, 2, 0
    assert {series.name: series.colour for series in plot.panels[0].series} == {"x": vermillion, "y": green, "z": blue}


def test_scene_has_shafts_through_base_and_tips() -> None:
    frames = [at_rcm("a", 50, 0, 0), at_rcm("b", 50, 0, 0), failed("c")]
    frames[0] = replace(frames[0], tips=(np.array([0.01, 0.02, 0.12]),))
    scene = json.loads(scene_of(frames, FrameBases.of(frames)) or "")
    assert [one[:2] for one in scene["frames"]] == [[0, "ok"], [1, "ok"]]
    assert scene["frames"][0][3:] == [[10, -20, 100], [10, 20, 120]]
    assert scene["base"][3] == [50, 0, 0]
    assert scene["base"][0] == [70, 0, 0]
    assert scene_of([failed("c")], None) is None


def test_no_joint_plot_without_readings() -> None:
    assert joint_plot([result("a", readings={}), failed("b")]) is None


def test_rcm_plot_has_one_scale_and_clamps_far_points() -> None:
    frames = [at_rcm("a", 50, 0, 0), at_rcm("b", 51, 1, 0), at_rcm("c", 49, -1, 0), at_rcm("far", 50, 0, 400)]
    base = FrameBases.of(frames)
    assert base is not None
    plot = rcm_plot(frames, base)
    scales = {
        round(abs(axis.end - axis.start) / (axis.high - axis.low), 6)
        for panel in plot.panels
        for axis in (panel.across, panel.up)
    }
    assert len(scales) == 1
    from_front, from_side = ([mark.beyond for mark in panel.series[0].marks] for panel in plot.panels)
    assert from_front == [False] * 4
    assert from_side == [False] * 3 + [True]
    assert plot.beyond == ("far (400 mm away)",)


@given(low=st.floats(-1e4, 1e4), span=st.floats(1e-3, 1e4), most=st.integers(2, 12))
def test_axis_labels_are_round_and_few(low: float, span: float, most: int) -> None:
    axis = value_axis("x", low, low + span, start=0, end=100, most=most)
    assert axis.low <= low + 1e-6 * span
    assert axis.high >= low + span * (1 - 1e-6)
    assert 2 <= len(axis.ticks) <= most + 2
    for text, at in axis.ticks:
        assert axis.at(float(text)) == pytest.approx(at, abs=1e-3)


@pytest.mark.parametrize(("span", "step"), [(10, 2), (11, 2), (13, 5), (0.7, 0.1), (1000, 200), (3, 0.5)])
def test_steps_are_1_2_or_5_times_power_of_ten(span: float, step: float) -> None:
    assert round_step(span, 6 if span != 0.7 else 7) == pytest.approx(step)


def test_many_frames_are_labelled_at_equal_distances() -> None:
    axis = name_axis(tuple(f"{k:04d}" for k in range(1000)), start=0, end=1000)
    assert [text for text, _ in axis.ticks] == [f"{k:04d}" for k in range(0, 1000, 100)]


def test_speed_is_distance_of_the_tips_by_the_time_since_the_frame_before() -> None:
    def at(name: str, time: float | None, millimetres: float, **changes: object) -> Result:
        tips = tuple(np.array([1e-3 * millimetres, y, 0.1]) for y in (0.0, 0.01))
        return result(name, time=time, tips=tips, **changes)

    frames = [at("a", 1.0, 0.0), at("b", 1.5, 10.0), failed("x"), at("c", 2.5, 40.0, status="doubtful", reasons=("x",))]
    frames[2] = replace(frames[2], time=2.0)
    plot = speed_plot(frames)
    assert plot is not None
    (panel,) = plot.panels
    marks = panel.series[0].marks
    assert [(mark.place, mark.sure) for mark in marks] == [(1, True), (3, False)]
    assert [mark.y for mark in marks] == pytest.approx([panel.up.at(20.0), panel.up.at(30.0)])
    assert [mark.x for mark in marks] == pytest.approx([panel.across.at(0.5), panel.across.at(1.5)])
    assert speed_plot([at("a", None, 0.0), at("b", None, 1.0)]) is None
    assert speed_plot([at("a", 1.0, 0.0), at("b", 1.0, 1.0)]) is None
