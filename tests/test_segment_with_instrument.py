"""Masks of a known instrument, the poses that come of them, and which of the two is to blame for a doubt."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_tools import Drawing, draw_tool

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import estimate_frame, run_frame
from dvrk_cmaes.segment import Segmentation
from dvrk_cmaes.segment.mask_or_pose import who_is_to_blame
from dvrk_cmaes.segment.with_instrument import Segmenter
from dvrk_cmaes.silhouette import Body

Found = tuple[FrameData, Result, Result]


@pytest.fixture(scope="module")
def session() -> Session:
    return read_session(bundled_path("demo"))


def both_ways(session: Session, files: FrameFiles, body: Body) -> Found:
    """The frame with the mask that is found in its image, the pose from that, and the pose from the given mask."""
    config = EstimateConfig()
    given = estimate_frame(files, read_frame(files, session.camera), body, arm="classic", config=config)
    alone = replace(files, mask=None)
    data = read_frame(alone, session.camera, Segmenter(body, config))
    return data, estimate_frame(alone, data, body, arm="classic", config=config), given


@pytest.fixture(scope="module")
def found(session: Session, bundled_body: Body) -> Found:
    return both_ways(session, session.frames[0], bundled_body)


def test_an_image_alone_gives_the_pose(session: Session, bundled_body: Body, found: Found) -> None:
    data, result, _ = found
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
    assert data.segmentation is not None
    assert data.segmentation.confidence > 0.9


def test_the_result_says_how_the_mask_was_found_and_what_it_took(found: Found) -> None:
    data, result, given = found
    assert data.segmentation is not None
    stated = f"mask found in the image by the classic model, confidence {data.segmentation.confidence:.2f}"
    assert stated in result.warnings
    assert not any("mask found" in warning for warning in given.warnings)
    assert result.seconds > data.segment_seconds > 0


def test_the_same_image_gives_the_same_pose(session: Session, bundled_body: Body, found: Found) -> None:
    again = read_frame(replace(session.frames[0], mask=None), session.camera, Segmenter(bundled_body, EstimateConfig()))
    assert np.array_equal(again.mask, found[0].mask)


def test_the_mask_that_was_found_is_kept(session: Session, bundled_body: Body, found: Found, tmp_path: Path) -> None:
    run = run_frame(session.frames[0], found[0], bundled_body, arm="classic", config=EstimateConfig(), out=tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in run.written] == [
        "frames/0000.json",
        "overlays/0000.jpg",
        "masks/0000.png",
    ]
    assert np.array_equal(read_mask(tmp_path / "masks" / "0000.png"), found[0].mask)


def test_a_guess_makes_a_pose_doubtful_and_is_blamed(session: Session, bundled_body: Body, found: Found) -> None:
    data = found[0]
    assert data.segmentation is not None
    unsure = replace(data, segmentation=replace(data.segmentation, confidence=0.31))
    result = estimate_frame(session.frames[0], unsure, bundled_body, arm="classic", config=EstimateConfig())
    assert result.status == "doubtful"
    assert result.reasons == (
        "mask is a guess: confidence 0.31, expected at least 0.5",
        "mask or pose: the mask is probably to blame: it is a guess, confidence 0.31",
    )


def test_an_image_without_instrument_is_refused_by_name(bundled_body: Body, session: Session, tmp_path: Path) -> None:
    from dvrk_cmaes.io.atomic import write_image

    write_image(tmp_path / "wall.png", np.full((480, 640, 3), 90, np.uint8))
    files = FrameFiles("wall", None, image=tmp_path / "wall.png")
    with pytest.raises(DvrkCmaesError) as failed:
        read_frame(files, session.camera, Segmenter(bundled_body, EstimateConfig()))
    assert str(failed.value) == (
        f"{tmp_path / 'wall.png'}: no instrument found in the image; "
        "a mask, a box or a point on the instrument would help"
    )
    with pytest.raises(InputError, match=r"frame wall: expected a mask, got .*wall\.png"):
        read_frame(files, session.camera)


@pytest.fixture(scope="module")
def drawing() -> Drawing:
    return draw_tool()


def without_end(mask: np.ndarray) -> np.ndarray:
    cut = mask.copy()
    cut[:, 190:] = False
    return cut


def test_a_mask_that_lacks_what_the_image_shows_is_to_blame(drawing: Drawing) -> None:
    lacking = Segmentation(without_end(drawing.mask), None, 0.95)
    assert who_is_to_blame(drawing.image, lacking, drawing.mask) == (
        "the mask is probably to blame: where it differs from the silhouette, the image's colours side with the "
        "silhouette"
    )


def test_a_mask_that_the_image_bears_out_is_not_to_blame(drawing: Drawing) -> None:
    right = Segmentation(drawing.mask, None, 0.95)
    assert who_is_to_blame(drawing.image, right, without_end(drawing.mask)) == (
        "the mask is probably not to blame: where the silhouette differs from it, the image's colours side with the "
        "mask; instrument, camera or readings may be wrong"
    )
    assert who_is_to_blame(drawing.image, right, drawing.mask) == (
        "the mask is probably not to blame: the silhouette fits it, and the image bears it out"
    )


def test_where_it_cannot_be_told_that_is_said(drawing: Drawing) -> None:
    unsure = Segmentation(drawing.mask, None, 0.6)
    assert who_is_to_blame(drawing.image, unsure, drawing.mask) == (
        "whether mask or pose is to blame cannot be told: they agree, confidence 0.60"
    )
    assert who_is_to_blame(drawing.image, unsure, without_end(drawing.mask)) == (
        "whether mask or pose is to blame cannot be told: the image's colours side with neither clearly"
    )
    ignored = np.zeros_like(drawing.mask)
    ignored[:, 188:] = True
    assert "they agree" in who_is_to_blame(drawing.image, unsure, without_end(drawing.mask), ignored)


@pytest.mark.shared
@pytest.mark.parametrize("frame", ["medium/0240"])
def test_real_images_alone_give_the_poses_of_given_masks(shared: Path, scanned_body: Body, frame: str) -> None:
    folder, name = frame.split("/")
    session = read_session(shared / "frames" / "real" / folder)
    files = next(files for files in session.frames if files.name == name)
    _, result, given = both_ways(session, files, scanned_body)
    assert result.camera_from_root is not None
    assert given.camera_from_root is not None
    error = compare_poses(
        scanned_body.instrument,
        (result.camera_from_root, result.joints),
        (given.camera_from_root, given.joints),
    )
    assert error.root_mm <= 5
    assert error.shaft_deg <= 10
