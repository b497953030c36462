"""The calibration of a session on the page: figures, plots, frames left out and leave-one-out predictions."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.page_calibrations import (
    BASE,
    BASE_STD,
    OFFSETS,
    SPREADS,
    STD,
    cables_of,
    calibration,
    solved,
    write_calibrated,
)
from helpers.page_results import failed, page_of, write_results

from dvrk_cmaes.calibration.lag_search import LagCurve
from dvrk_cmaes.calibration.session_rig import ViewRotation, ViewScale
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.report.page import render_page, write_page
from dvrk_cmaes.report.page_calibration import MOST_PICTURES, calibration_view, left_out_views
from dvrk_cmaes.report.plots.lag import lag_plot
from dvrk_cmaes.report.plots.shafts import ShaftsView, shafts_plot
from dvrk_cmaes.results.folder import read_results
from dvrk_cmaes.results.result import Quality, Result

NAMES = ("a", "b", "c", "d", "e")


def view_of(out: Path, frames: list[Result], **changes: object) -> SimpleNamespace:
    one = calibration(frames, **changes)
    folder = read_results(write_calibrated(out, frames, one))
    return calibration_view(folder, one, left_out_views(folder, one, folder.frames))


def distance_from_line(line: tuple[tuple[float, float], tuple[float, float]], point: tuple[float, float]) -> float:
    (x, y), end = line[0], np.array(line[1])
    along = (end - [x, y]) / np.linalg.norm(end - [x, y])
    across = np.array(point) - [x, y]
    return abs(float(along[0] * across[1] - along[1] * across[0]))


def test_no_section_without_calibration(tmp_path: Path) -> None:
    page = page_of(write_results(tmp_path, solved(NAMES)))
    assert "#calibration" not in page.addresses
    assert "Leave one out" not in page.text


def test_base_and_offsets_with_standard_deviations(tmp_path: Path) -> None:
    frames = solved(NAMES)
    text = page_of(write_calibrated(tmp_path, frames, calibration(frames))).text
    for part in (
        "Calibration ✓ ok",
        "Frames used 5 of 5 none left out",
        "Predicted by the others, IoU 0.820 mean; lowest 0.800 (a)",
        "Predicted by the others, outline 2.8 px median; worst 3.0 px (a)",
        "RCM, standard deviation 0.30 mm",
        "Base's rotation, standard deviation 0.30°",
        "position (RCM), mm 70.00 -70.00 55.00 standard deviation along its own axes, mm 0.30 0.10 0.20",
        "axis-angle, deg 51.57 103.13 -22.92 standard deviation about its own axes, deg 0.10 0.20 0.30",
        "insertion, mm +0.40 0.10 ± 0.20",
        "roll, deg +2.00 1.00 ± 2.00",
        "wrist_pitch, deg -8.00 0.50 ± 1.00",
        f"{BASE[0, 0]:.9f}",
    ):
        assert part in text


def test_what_needs_action_comes_first_then_the_calibration_then_what_it_cannot_tell(tmp_path: Path) -> None:
    frames = solved(NAMES)
    words = {
        "untold": ("offset of <b>roll</b>: standard deviation 10.9 deg",),
        "doubts": ("the arm's base or the camera moved between frames b and c",),
        "lag": Lag(2.0, 0.1, 0.08, 0.004),
    }
    page = page_of(write_calibrated(tmp_path, frames, calibration(frames, **words)))
    part = page.text
    order = (
        "Of the session as a whole: the arm's base or the camera moved between frames b and c",
        "Calibration ? doubtful",
        "Frames used",
        "This session cannot tell: offset of <b>roll</b>",
        "All frames",
        "Overlap (IoU), median",
    )
    places = [part.index(text) for text in order]
    assert places == sorted(places)
    assert "images are 2.00 frames (0.080 s) later than the readings, std 0.10 frames; taken out of the" in part


def test_lag_is_shown_with_the_curve_of_disagreement(tmp_path: Path) -> None:
    frames = solved(NAMES)
    lags = np.arange(-5.0, 16.0)
    curve = LagCurve.of("frames", lags, np.minimum(0.2 * (lags - 4) ** 2, 4.0))
    page = page_of(write_calibrated(tmp_path, frames, calibration(frames, lag=Lag(3.9, 0.1), lag_curve=curve)))
    assert "lag: images are 3.90 frames later than the readings, std 0.10 frames; taken out of the" in page.text
    assert "How late the images are" in page.text
    plot = lag_plot(calibration(frames, lag=Lag(3.9, 0.1), lag_curve=curve))
    assert plot is not None
    assert plot.found == pytest.approx(plot.across.at(3.9))
    assert plot.points[9] == pytest.approx((plot.across.at(4.0), plot.up.at(0.0)))
    assert lag_plot(calibration(frames)) is None


def test_lag_that_is_zero_within_its_error_is_not_taken_out(tmp_path: Path) -> None:
    frames = solved(NAMES)
    page = page_of(write_calibrated(tmp_path, frames, calibration(frames, lag=Lag(0.1, 0.2, applied=False))))
    assert "0.10 frames later than the readings, std 0.20 frames; zero within its error, not taken out" in page.text
    assert "How late the images are" not in page.text


def test_figures_of_session_are_without_frames_left_out(tmp_path: Path) -> None:
    frames = solved(NAMES)
    bad = replace(frames[4], quality=Quality(0.3, 1.0, {}, 20.0, 60.0), seconds=99.0)
    session = calibration(frames[:4], left_out={"e": "another mode"})
    text = page_of(write_calibrated(tmp_path, [*frames[:4], bad], session)).text
    assert "Overlap (IoU), median 0.960 lowest 0.960" in text
    assert "slowest 4.00 s" in text
    assert "IoU 0.300" in text  # its card is there all the same


def test_left_out_frames_are_listed_with_reason_and_link(tmp_path: Path) -> None:
    frames = [*solved(NAMES[:3]), failed("no pose")]
    reasons = {"d & e": "no readings <at all>", "no pose": "no pose: the mask is empty"}
    page = page_of(write_calibrated(tmp_path, frames, calibration(frames[:3], left_out=reasons)))
    assert "Frames used 3 of 5 2 left out" in page.text
    assert "frame why d & e no readings <at all> no pose no pose: the mask is empty" in page.text
    assert re.search("Left out of the session.s calibration no pose: the mask is empty", page.text)
    assert page.addresses.count("#frame-no%20pose") == 1
    assert not [address for address in page.addresses if "d%20%26" in address]


def test_leave_one_out_predictions_are_listed_worst_first(tmp_path: Path) -> None:
    names = [f"{k:02d}" for k in range(20)]
    frames = solved(names)
    alone = {name: (0.9 - 0.01 * k, 1.0 + k) for k, name in enumerate(names)}
    view = view_of(tmp_path, frames, leave_one_out=alone)
    assert [one.frame for one in view.predictions] == names[::-1]
    assert [one.frame for one, _ in view.pictures] == names[: -MOST_PICTURES - 1 : -1]
    page = page_of(tmp_path)
    shown = [address for address in page.addresses if address.startswith("overlays_left_out/")]
    assert len(shown) == len(names)  # the link in each frame; the pictures are within the page
    assert "19 0.710 20.0 0.960 ok 18 0.720" in page.text
    assert "predicted by the others IoU 0.7100, outline 20.00 px median" in page.text


def test_prediction_without_picture_is_listed(tmp_path: Path) -> None:
    frames = solved(NAMES)
    page = page_of(write_calibrated(tmp_path, frames, calibration(frames), pictures=["b"]))
    pictures = {address for address in page.addresses if address.startswith("overlays_left_out/")}
    assert pictures == {"overlays_left_out/b.jpg"}
    assert "a 0.800 3.0 0.960 ok b 0.810" in page.text


def test_page_refers_to_own_folder_only(tmp_path: Path) -> None:
    frames = solved(["a", "größe #1?"])
    addresses = page_of(write_calibrated(tmp_path, frames, calibration(frames))).addresses
    known = ("data:", "#", "overlays/", "overlays_left_out/", "frames/", "session.json")
    assert [address for address in addresses if not address.startswith(known)] == []
    assert "overlays_left_out/gr%C3%B6%C3%9Fe%20%231%3F.jpg" in addresses


def test_frame_name_does_not_lead_to_other_pictures(tmp_path: Path) -> None:
    frames = solved(NAMES)
    out = write_calibrated(tmp_path / "out", frames, calibration([*frames, replace(frames[0], frame="../../secret")]))
    (out / "overlays_left_out" / "a.jpg").rename(tmp_path / "secret.jpg")
    document = json.loads((out / "frames" / "a.json").read_text())
    (out / "frames" / "a.json").write_text(json.dumps(document | {"frame": "../../secret"}))
    pictures = [address for address in page_of(out).addresses if "secret" in address and not address.startswith("#")]
    assert pictures == []


def test_single_frame_report_is_linked_if_present(tmp_path: Path) -> None:
    frames = solved(NAMES)
    out = write_calibrated(tmp_path, frames, calibration(frames))
    assert "alone/report.html" not in page_of(out).addresses
    write_page(write_results(out / "alone", [replace(frame, source="frame") for frame in frames]))
    assert "alone/report.html" in page_of(out).addresses
    assert "Each frame was solved by itself" in page_of(out / "alone").text


def test_agreement_of_frames_solved_together_is_not_stated_as_a_figure(tmp_path: Path) -> None:
    together = page_of(write_results(tmp_path / "together", solved(NAMES))).text
    alone = page_of(write_results(tmp_path / "alone", [replace(one, source="frame") for one in solved(NAMES)])).text
    for figure in ("RCM, spread", "Arm's base, rotation", "Shaft axes meet"):
        assert (figure in together, figure in alone) == (False, True)


def test_page_is_reproducible(tmp_path: Path) -> None:
    frames = solved(NAMES)
    pages = [write_page(write_calibrated(tmp_path / k, frames, calibration(frames))).read_bytes() for k in "12"]
    assert pages[0] == pages[1]


def test_damaged_calibration_is_refused(tmp_path: Path) -> None:
    frames = solved(NAMES)
    out = write_calibrated(tmp_path, frames, calibration(frames))
    document = json.loads((out / "session.json").read_text())
    (out / "session.json").write_text(json.dumps(document | {"camera_from_base": "here"}))
    with pytest.raises(InputError, match=r"session\.json: camera_from_base: expected"):
        render_page(read_results(out))


def test_offset_plot_positions_agree_with_axis(tmp_path: Path) -> None:
    off = {"a": (1e-4, math.radians(1)), "b": (-2e-4, math.radians(-3))}
    panels = view_of(tmp_path, solved(NAMES, off)).offset_panels
    assert [[row.joint for row in panel.rows] for panel in panels] == [
        ["roll", "wrist_pitch", "wrist_yaw", "jaw"],
        ["insertion"],
    ]
    for panel, factor in zip(panels, (180 / math.pi, 1e3), strict=True):
        for row in panel.rows:
            middle, std, spread = (factor * by[row.joint] for by in (OFFSETS, STD, SPREADS))
            assert row.offset == pytest.approx(panel.across.at(middle))
            assert row.std == pytest.approx([panel.across.at(middle - std), panel.across.at(middle + std)])
            assert row.frame_std == pytest.approx([panel.across.at(middle - spread), panel.across.at(middle + spread)])
            assert [mark.place for mark in row.marks] == [0, 1, 2, 3, 4]
    (roll, *wrist), (insertion,) = (panel.rows for panel in panels)
    degrees, millimetres = (panel.across for panel in panels)
    assert [mark.x for mark in roll.marks] == pytest.approx([degrees.at(deg) for deg in (3, -1, 2, 2, 2)], abs=1e-3)
    shifts = (0.5, 0.2, 0.4, 0.4, 0.4)
    assert [mark.x for mark in insertion.marks] == pytest.approx([millimetres.at(mm) for mm in shifts], abs=1e-3)
    assert {round(mark.x - row.offset, 3) for row in wrist for mark in row.marks} == {0.0}


def test_far_frame_is_drawn_at_border_of_offset_plot(tmp_path: Path) -> None:
    view = view_of(tmp_path, solved(NAMES, {"c": (0.0, math.radians(70))}))
    roll = view.offset_panels[0].rows[0]
    assert [mark.beyond for mark in roll.marks] == [False, False, True, False, False]
    assert roll.marks[2].x == view.offset_panels[0].across.end
    assert view.beyond


def test_shafts_are_drawn_through_rcm_at_one_scale() -> None:
    frames = solved(NAMES)
    plot = shafts_plot(calibration(frames), dict(enumerate(f.camera_from_root for f in frames)), frozenset(range(5)))
    assert plot is not None
    for views in (plot.far, plot.near):
        scales = {
            round(abs(axis.end - axis.start) / (axis.high - axis.low), 6)
            for view in views
            for axis in (view.across, view.up)
        }
        assert len(scales) == 1
        for view, column in zip(views, (0, 2), strict=True):
            assert view.rcm == pytest.approx((view.across.at(1e3 * BASE[column, 3]), view.up.at(1e3 * BASE[1, 3])))
            assert [line.place for line in view.lines] == [0, 1, 2, 3, 4]
            assert all(distance_from_line((line.start, line.end), view.rcm) < 0.01 for line in view.lines)
            assert all(within(view, point) for line in view.lines for point in (line.start, line.end))
    for view, column in zip(plot.far, (0, 2), strict=True):
        assert view.camera == pytest.approx((view.across.at(0), view.up.at(0)))
        for place, line in enumerate(view.lines):
            root = 1e3 * frames[place].camera_from_root[:3, 3]
            assert line.end == pytest.approx((view.across.at(root[column]), view.up.at(root[1])))


def within(view: ShaftsView, point: tuple[float, float]) -> bool:
    """Whether a point lies within a view or on its border."""
    left, right = view.across.start, view.across.end
    top, bottom = sorted((view.up.start, view.up.end))
    return left - 1e-6 <= point[0] <= right + 1e-6 and top - 1e-6 <= point[1] <= bottom + 1e-6


def test_rcm_ellipse_is_one_standard_deviation() -> None:
    frames = solved(NAMES)
    plot = shafts_plot(calibration(frames), {0: frames[0].camera_from_root}, frozenset({0}))
    assert plot is not None
    spread = BASE[:3, :3] @ np.diag(BASE_STD[:3] ** 2) @ BASE[:3, :3].T * 1e6
    for view, column in zip(plot.near, (0, 2), strict=True):
        scale = (view.across.end - view.across.start) / (view.across.high - view.across.low)
        long, narrow, turn = view.ellipse
        axes = np.array([[np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))]])
        axes = np.concatenate([axes, axes[:, ::-1] * [-1, 1]])
        drawn = axes.T @ np.diag([long**2, narrow**2]) @ axes / scale**2
        np.testing.assert_allclose(drawn, spread[np.ix_((column, 1), (column, 1))], atol=1e-9)


def test_left_out_shaft_is_marked_without_widening_views() -> None:
    frames = solved(NAMES)
    poses = dict(enumerate(frame.camera_from_root for frame in frames))
    astray = transform_away(frames[0].camera_from_root)
    one, other = (shafts_plot(calibration(frames), more, frozenset(range(5))) for more in (poses, poses | {5: astray}))
    assert one is not None
    assert other is not None
    for before, after in zip((*one.far, *one.near), (*other.far, *other.near), strict=True):
        assert (before.across, before.up) == (after.across, after.up)
        assert [line.place for line in after.lines if not line.used] in ([], [5])
    assert any(not line.used for view in other.far for line in view.lines)


def transform_away(pose: np.ndarray) -> np.ndarray:
    """Give the pose of a parallel shaft 30 mm aside."""
    aside = pose.copy()
    aside[:3, 3] += 0.03 * pose[:3, 0]
    return aside


def test_no_shafts_plot_without_used_frames() -> None:
    assert shafts_plot(calibration(solved(NAMES)), {}, frozenset({0, 1})) is None


def test_cables_are_told_in_words_and_drawn_over_reading_and_time(tmp_path: Path) -> None:
    frames = [replace(frame, time=float(k)) for k, frame in enumerate(solved(NAMES))]
    view = view_of(tmp_path / "view", frames, cables=cables_of(frames))
    assert view.cables[:2] == (
        "wrist_yaw stays behind its reading by up to 9 deg, std 2",
        "wrist_yaw drags wrist_pitch by +14 deg a rad, std 3",
    )
    assert view.cables_plot is not None
    assert [panel.across.label for panel in view.cables_plot.panels[:2]] == ["reading of wrist_pitch, deg", "time, s"]
    assert all(len(series.marks) == len(NAMES) for panel in view.cables_plot.panels for series in panel.series)
    text = page_of(write_calibrated(tmp_path / "page", frames, calibration(frames, cables=cables_of(frames)))).text
    assert "What the cables do" in text
    assert "wrist_yaw drags wrist_pitch by +14 deg a rad, std 3" in text


def test_time_of_images_that_are_only_counted_is_called_so(tmp_path: Path) -> None:
    frames = solved(NAMES)
    plot = view_of(tmp_path, frames, cables=cables_of(frames)).cables_plot
    assert plot is not None
    assert plot.panels[1].across.label == "time at 30 images a second, s"


def test_page_of_a_session_that_does_not_tell_of_its_cables_has_no_plot_of_them(tmp_path: Path) -> None:
    frames = solved(NAMES)
    assert view_of(tmp_path / "view", frames).cables_plot is None
    assert "What the cables do" not in page_of(write_calibrated(tmp_path / "page", frames, calibration(frames))).text


def test_rig_that_differs_is_said(tmp_path: Path) -> None:
    frames = solved(("a", "b"))
    view = ViewRotation(
        "right",
        np.array([0.1, 0.0, 0.3]),
        np.array([0.01, 0.02, 0.03]),
        12,
        applied=False,
        baseline=ViewScale(1.05, 0.012, applied=True),
    )
    words = view_of(tmp_path, frames, rig=(view,)).words
    assert "the right eye's baseline is 5.0 % (std 1.2) longer than in the file" in words
    assert not any("focal length" in text for text in words)
