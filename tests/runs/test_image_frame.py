"""Frames that have only an image: the mask found in it, and the pose from that mask."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.done_once import segmented_anew
from helpers.files import read_mask, write_image
from helpers.places import bundled_path

from dvrk_cmaes import (
    Body,
    DvrkCmaesError,
    EstimateConfig,
    FrameFiles,
    InputError,
    Result,
    Session,
    estimate,
    read_frame,
    read_session,
)
from dvrk_cmaes.estimation import image_frame
from dvrk_cmaes.estimation.image_frame import SegmentedFrame, segment_and_estimate
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.runs.frame import estimate_frame, run_frame
from dvrk_cmaes.segment import Segmentation

METHOD = FrameMethod("classic", EstimateConfig())

Found = tuple[SegmentedFrame, Result]


@pytest.fixture(scope="module")
def session() -> Session:
    return read_session(bundled_path("demo"))


def solve_image(session: Session, files: FrameFiles, body: Body) -> SegmentedFrame:
    files = replace(files, mask=None)
    return segment_and_estimate(read_frame(files, session.rig), files, body, METHOD)


def both_ways(session: Session, files: FrameFiles, body: Body) -> Found:
    """Return the frame solved from its image alone, and its result from the given mask."""
    given = estimate_frame(files, read_frame(files, session.camera), body, METHOD)
    return solve_image(session, files, body), given


def without_seconds(result: Result) -> dict[str, object]:
    return {**result.to_dict(), "seconds": 0}


@pytest.fixture(scope="module")
def found(session: Session, bundled_body: Body) -> Found:
    return both_ways(session, session.frames[0], bundled_body)


def test_image_alone_gives_pose(session: Session, bundled_body: Body, found: Found) -> None:
    result = found[0].result
    truth = session.truth.frames[result.frame]
    assert result.camera_from_root is not None
    error = compare_poses(
        bundled_body.instrument,
        (result.camera_from_root, result.joints),
        (truth.camera_from_root, truth.joints),
    )
    assert error.root_mm < 2.5
    assert error.shaft_deg < 5
    assert result.status == "ok"
    assert found[0].segmentation.confidence > 0.9


def test_result_states_origin_of_mask(found: Found) -> None:
    frame, given = found
    stated = f"mask found in the image by the classic model, confidence {frame.segmentation.confidence:.2f}"
    assert stated in frame.result.warnings
    assert not any("mask found" in warning for warning in given.warnings)


def test_found_mask_is_written_and_a_repeated_estimate_is_identical(
    session: Session, bundled_body: Body, found: Found, tmp_path: Path
) -> None:
    files = replace(session.frames[0], mask=None)
    frame = read_frame(files, session.camera)
    with segmented_anew():
        result, written = run_frame(files, frame, bundled_body, METHOD, tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in written] == [
        "frames/0000.json",
        "overlays/0000.jpg",
        "masks/0000.png",
    ]
    assert np.array_equal(read_mask(tmp_path / "masks" / "0000.png"), found[0].data.mask)
    assert without_seconds(result) == without_seconds(found[0].result)


def test_guessed_mask_makes_pose_doubtful(
    session: Session, bundled_body: Body, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    guess = Segmentation(found[0].data.mask, 0.31)
    monkeypatch.setattr(image_frame, "segment_first", lambda *_, **__: guess)
    monkeypatch.setattr(image_frame, "segment_again", lambda *_, **__: None)
    result = solve_image(session, session.frames[0], bundled_body).result
    assert result.status == "doubtful"
    assert result.reasons == ("mask is a guess: confidence 0.31, expected at least 0.5",)


def test_mask_around_a_pose_is_no_surer_and_keeps_the_other_instruments(
    session: Session, bundled_body: Body, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    mask, which = found[0].data.mask, "two instruments, the left one taken (pass --point)"
    other = Segmentation(np.zeros_like(mask), 0.6)
    first = Segmentation(mask, 0.6, (which,), None, (other,))
    monkeypatch.setattr(image_frame, "segment_first", lambda *_, **__: first)
    frame = solve_image(session, session.frames[0], bundled_body)
    assert frame.segmentation.confidence == 0.6
    assert frame.segmentation.others == (other,)
    assert which in frame.result.warnings


def test_mask_around_a_pose_from_a_guess_is_called_a_guess(
    session: Session, bundled_body: Body, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    why = ("its shape is not the instrument's",)
    monkeypatch.setattr(image_frame, "segment_first", lambda *_, **__: Segmentation(found[0].data.mask, 0.3, why))
    frame = solve_image(session, session.frames[0], bundled_body)
    assert frame.segmentation.confidence == 0.3
    assert set(why) <= set(frame.result.warnings)


def test_image_without_instrument_is_refused(bundled_body: Body, session: Session, tmp_path: Path) -> None:
    write_image(tmp_path / "wall.png", np.full((480, 640, 3), 90, np.uint8))
    files = FrameFiles("wall", None, image=tmp_path / "wall.png")
    with pytest.raises(DvrkCmaesError) as failed:
        solve_image(session, files, bundled_body)
    assert str(failed.value) == (
        f"{tmp_path / 'wall.png'}: no instrument found in the image; "
        "a mask, a box or a point on the instrument would help"
    )
    read = read_frame(files, session.camera)
    assert not read.views[0].given
    with pytest.raises(InputError, match="mask"):
        estimate(read.mask, read.camera, instrument=bundled_body)


@pytest.mark.parametrize("frame", ["medium/0240"])
def test_real_images_give_poses_of_given_masks(shared: Path, scanned_body: Body, frame: str) -> None:
    folder, name = frame.split("/")
    session = read_session(shared / "frames" / "real" / folder)
    files = next(files for files in session.frames if files.name == name)
    segmented, given = both_ways(session, files, scanned_body)
    result = segmented.result
    assert result.camera_from_root is not None
    assert given.camera_from_root is not None
    error = compare_poses(
        scanned_body.instrument,
        (result.camera_from_root, result.joints),
        (given.camera_from_root, given.joints),
    )
    assert error.root_mm <= 5
    assert error.shaft_deg <= 10
