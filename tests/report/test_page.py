"""The page of a session's results: its contents and order, and the escaping of names and texts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.files import write_json
from helpers.page_calibrations import cables_of, calibration, solved, write_calibrated
from helpers.page_results import doubtful, failed, page_of, result, write_results
from helpers.transforms import exp_rotation, transform

from dvrk_cmaes import InputError, Lag, Result
from dvrk_cmaes.calibration.lag import LagCurve
from dvrk_cmaes.report.page import write_page
from dvrk_cmaes.report.template import counted_reasons
from dvrk_cmaes.results.result import ExpectedError

NAMES = ("a", "b", "c", "d", "e")


def at_rcm(name: str, *millimetres: float) -> Result:
    return result(name, camera_from_base=transform(np.eye(3), np.array(millimetres) / 1e3))


def test_worst_frames_come_first_with_their_overlays(tmp_path: Path) -> None:
    frames = [
        result("fine", tip_probability=0.9),
        result("less sure", tip_probability=0.8),
        doubtful("doubtful", "a: x", "b: y", near=0.6, iou=0.8),
        doubtful("less sure, doubtful", "a: x", near=0.5),
        doubtful("less overlap", "a: x", near=0.5, iou=0.8),
        doubtful("not stated", "a: x", near=None, iou=0.95),
        failed("no pose"),
    ]
    page = page_of(write_results(tmp_path, frames))
    doubts = ["not stated", "less overlap", "less sure, doubtful", "doubtful"]
    assert page.frames == ["no pose", *doubts, "less sure", "fine"]
    assert sum(address.startswith("data:image/webp") for address in page.addresses) == len(frames)


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


def test_tips_that_a_mask_does_not_determine_have_no_distance(tmp_path: Path) -> None:
    errors = {"a": ExpectedError({"mean": 1.0}, {}, 1.5, 0.5), "b": ExpectedError({"mean": 900.0}, {}, 1921.0, 0.5)}
    text = page_of(write_results(tmp_path, [result(k, expected_error=error) for k, error in errors.items()])).text
    assert "1.5 mm at worst 1.5 mm (a); not determined in 1 frame" in text
    assert "1921" not in text


def test_details_of_frame(tmp_path: Path) -> None:
    one = result(
        "a",
        status="doubtful",
        reasons=("twin undecided: why",),
        warnings=("intrinsics rescaled by 2",),
        unused=("no shaft edges: too short",),
    )
    text = page_of(write_results(tmp_path, [one])).text
    for part in (
        "roll_link: position, mm 10.00 -20.00 100.00",
        "std along the camera's axes, mm 1.14 2.11 2.87",
        "std about the camera's axes, deg 0.66 1.21 1.65",
        "wrist_pitch, deg 28.65 2.29 22.92 +5.73",
        "insertion, mm - - 150.00 -",
        "arm's base (RCM): position, mm 60.00 -70.00 50.00",
        "twin undecided: why",
        "intrinsics rescaled by 2",
        "not used: no shaft edges: too short",
        "mirror twin 0.9550 0.1 41.5 0.0 0.0",
    ):
        assert part in text


def test_summary_of_session(tmp_path: Path) -> None:
    frames = [at_rcm("a", 50, 0, 0), at_rcm("b", 53, 0, 0), at_rcm("c", 47, 0, 0), doubtful("d", "x: y"), failed("e")]
    frames[3] = replace(frames[3], camera_from_base=transform(exp_rotation([0, 0, 0.5]), [0.05, 0, 0]), seconds=2.5)
    summary = {"session": "/data/pig 3", "missing": ["x", "y"], "timing": {"run": {"frames": 5, "seconds": 754.2}}}
    write_json(write_results(tmp_path, frames) / "summary.json", summary)
    text = page_of(tmp_path).text
    for part in (
        "pig 3 · 5 frames of lnd · dvrk-cmaes 1.2.3",
        "3 ok 1 doubtful 1 failed",
        "2 more frames have no result yet.",
        "Overlap (IoU), median 0.960 lowest 0.900 (d)",
        "Outline to mask, median 0.6 px 95 % of it within 2.1 px, in the worst frame 6.0 px",
        "Time a frame, median 1.50 s slowest 2.50 s; the run took 754 s",
    ):
        assert part in text


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


def test_reasons_are_counted_once_per_frame_with_what_to_do_about_them(tmp_path: Path) -> None:
    frames = [doubtful("a", "far: jaw", "far: yaw"), doubtful("b", "far: jaw", "no readings: x"), result("c")]
    assert counted_reasons(frame.reasons for frame in frames) == [("far", 2), ("no readings", 1)]
    text = "Why frames are not ok 2 far 1 no readings give readings (--joints FILE); --frame names the row"
    assert text in page_of(write_results(tmp_path, frames)).text


def test_warning_of_all_frames_is_shown_once_for_all(tmp_path: Path) -> None:
    frames = [result("a", warnings=("rescaled", "hot")), result("b", warnings=("rescaled",))]
    text = page_of(write_results(tmp_path, frames)).text
    assert "In every frame: rescaled" in text
    assert "In every frame: hot" not in text


# calibrations


def test_calibration_is_ok_over_frames_that_are_not_and_the_page_says_why_and_each_warning_once(tmp_path: Path) -> None:
    text = "no camera file: a focal length of 1034 px"
    frames = [replace(one, status="doubtful", reasons=("far: x",), remarks=(text,)) for one in solved(NAMES)]
    page = page_of(write_calibrated(tmp_path, frames, calibration(frames, remarks=(text,)))).text
    assert "Calibration of an arm and its camera 5 frames" in page
    assert page.count(text) == 1
    assert "It is ok, since the session predicts frames that it has not seen" in page
    assert "5 of 5 frames are not known well enough, 5 of them for: far." in page
    fine = page_of(write_calibrated(tmp_path / "ok", solved(NAMES), calibration(solved(NAMES)))).text
    assert "It is ok" not in fine


def test_doubts_of_a_calibration_come_first_and_what_it_cannot_tell_is_said(tmp_path: Path) -> None:
    frames = solved(NAMES)
    words = {
        "undetermined": ("offset of <b>roll</b>: standard deviation 10.9 deg",),
        "doubts": ("the arm's base or the camera moved between frames b and c",),
        "lag": Lag(2.0, 0.1, 0.08, 0.004),
        "left_out": {"e": "its mask is of another arm"},
    }
    curve = LagCurve("frames", tuple(zip(range(-5, 16), np.linspace(0, 4, 21).tolist(), strict=True)))
    session = calibration(frames, cables=cables_of(), lag_curve=curve, **words)
    text = page_of(write_calibrated(tmp_path, frames, session)).text
    order = (
        "Of the whole: the arm's base or the camera moved between frames b and c",
        "Calibration: doubtful One place of the arm's base",
        "images are 2.00 frames (0.080 s) later than the readings, std 0.10 frames; taken out of the",
        "not determined by this session: offset of <b>roll</b>",
        "How late the images are",
        "left out of the calibration: its mask is of another arm",
        "Leave one out: each frame as the others predict it, the worst first Its image",
    )
    places = [text.index(part) for part in order]
    assert places == sorted(places)
