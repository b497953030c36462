"""Edges that the colours of an image show, as a term of the pose."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.frame_terms import cost_of, local_of
from helpers.moving_worlds import moving_world

from dvrk_cmaes import Rig
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.prior import LIMIT_SIGMA
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.synth.images import draw_image
from dvrk_cmaes.track.colour_edges import ColourEdges, EdgeAppearance, EdgeFit, ImageEvidence, fit_edges, learned
from dvrk_cmaes.track.histogram_ratio import EdgeModel
from dvrk_cmaes.track.outlines import DrawnOutline, OutlineModel

TOOL, TISSUE, UNKNOWN = (90, 88, 86), (60, 70, 170), (200, 40, 20)  # BGR
HEIGHT, WIDTH = 80, 160


def bar(left: float, right: float, *, of: tuple[int, int, int] = TOOL, noise: float = 3.0) -> np.ndarray:
    """Draw an upright bar between two columns' left and right borders, blurred and noisy."""
    fine = 8
    covered = np.zeros((1, WIDTH * fine), np.float32)
    covered[:, round((left + 0.5) * fine) : round((right + 0.5) * fine)] = 1
    share = cv2.resize(covered, (WIDTH, 1), interpolation=cv2.INTER_AREA).repeat(HEIGHT, axis=0)[..., None]
    image = cv2.GaussianBlur(share, (0, 0), 0.8)[..., None] * np.array(of) + (
        1 - cv2.GaussianBlur(share, (0, 0), 0.8)[..., None]
    ) * np.array(TISSUE)
    image = image + noise * np.random.default_rng(1).standard_normal(image.shape)
    return np.clip(image + 0.5, 0, 255).astype(np.uint8)


def outline_of(left: float, right: float) -> DrawnOutline:
    """Give the outline of such a bar, 2 x 60 points."""
    rows = np.arange(10.0, 70.0)
    pixels = np.concatenate([np.stack([np.full(60, u), rows], axis=1) for u in (left, right)])
    normals = np.repeat([[-1.0, 0.0], [1.0, 0.0]], 60, axis=0)
    zero = np.zeros(120, np.intp)
    return DrawnOutline(0, zero, np.zeros((120, 3)), normals, np.ones(120), pixels)


def model_of(left: float = 60, right: float = 100) -> EdgeAppearance:
    """Learn what such a bar looks like."""
    outline = outline_of(left, right)
    return learned(bar(left, right), outline.pixels, outline)


@pytest.mark.parametrize("width", [8, 40])
@pytest.mark.parametrize("shift", [0.0, 0.4, 3.25, -5.0])
def test_edges_are_found_below_a_pixel(width: int, shift: float) -> None:
    image, outline = bar(60, 60 + width), outline_of(60 + shift, 60 + width + shift)
    found = ImageEvidence(image, model_of()).distances(outline.pixels, outline, 12.0)
    assert found.found.mean() > 0.95
    left, right = found.distance[:60], found.distance[60:]
    assert np.median(left) == pytest.approx(-shift, abs=0.1)
    assert np.median(right) == pytest.approx(shift, abs=0.1)


def test_edges_within_the_instrument_do_not_count() -> None:
    image, outline = bar(60, 100), outline_of(60, 100)
    image[:, 65:68] = (150, 148, 146)  # a reflection along the instrument, whose edges are sharper than its outline
    model = learned(image, outline.pixels, outline)
    shifted = outline_of(63, 103)
    found = ImageEvidence(image, model).distances(shifted.pixels, shifted, 12.0)
    assert np.median(found.distance[:60]) == pytest.approx(-3, abs=0.2)


def test_instrument_that_goes_on_beside_its_outline_is_unexplained() -> None:
    image, outline = bar(60, 100), outline_of(60, 80)
    evidence = ImageEvidence(image, model_of())
    assert evidence.unexplained(outline.pixels, outline) == pytest.approx(0.5, abs=0.02)
    whole = outline_of(60, 100)
    assert evidence.unexplained(whole.pixels, whole) == 0.0


SHADOW = (20, 23, 57)  # of the tissue


def test_edge_to_a_shadow_of_a_colour_that_the_instrument_has_too_is_told_by_the_change() -> None:
    outline, image, seen = outline_of(60, 100), bar(60, 100), bar(60, 100)
    seen[:, 101:106] = SHADOW
    seen[:, 90:95] = SHADOW  # a dark stripe on the instrument
    seen[:, 51:56] = TOOL  # another instrument beside it
    image[:, 101:120] = SHADOW
    moved = outline_of(62, 102)
    known = learned(seen, outline.pixels, outline)
    unknown = replace(known, edges=EdgeModel.of(known.edges.inside * 0, known.edges.outside * 0))
    found, without = (ImageEvidence(image, one).distances(moved.pixels, moved, 12.0) for one in (known, unknown))
    assert found.found[60:].mean() > 0.9
    assert np.median(found.distance[60:]) == pytest.approx(2, abs=0.8)
    assert without.found[60:].mean() < 0.1


# the models of colours and changes


# the term, of a real outline


@pytest.fixture(scope="module")
def shown() -> tuple[OutlineModel, dict[int, ImageEvidence], Posed]:
    """Give the outlines of an instrument, its image with colours that it was learned from, and its pose."""
    world = moving_world(2)
    truth = world.truths[0]
    at = Posed(truth.camera_from_root, truth.values)
    image = draw_image(world.camera, truth, np.random.default_rng(5))
    model = OutlineModel(world.body, Rig.of(world.camera), TrackConfig().points)
    drawn = model.draw(at, 0)
    assert drawn is not None
    return model, {0: ImageEvidence(image, learned(image, drawn.pixels, drawn))}, at


def fitted(shown: tuple[OutlineModel, dict[int, ImageEvidence], Posed], change: np.ndarray, *, far: bool) -> EdgeFit:
    """Fit the image from a pose that is changed by (9,), m and rad."""
    model, images, at = shown
    start = at.moved(change)
    found = fit_edges(model, images, start, Expected(start, np.diag([1e2] * 3 + [5.0] * 6) ** 2), far=far)
    assert found is not None
    return found


def test_slope_of_the_edges_is_the_difference_of_their_cost(
    shown: tuple[OutlineModel, dict[int, ImageEvidence], Posed],
) -> None:
    """The weights of edges that are found change with the pose, which the approximation leaves out."""
    model, images, at = shown
    off = at.moved(np.array([3e-4, 0, 0, 0, 0, 0, 0, 0, 0]))
    drawn = model.draw(off, 0)
    assert drawn is not None
    term = ColourEdges(model, [drawn], images, 12.0, np.eye(9))
    step = 2e-4 * np.eye(9)[0]
    difference = float((cost_of(term, off.moved(step)[None]) - cost_of(term, off.moved(-step)[None]))[0]) / 4e-4
    assert difference == pytest.approx(2 * float(local_of(term, off[None]).slope[0, 0]), rel=0.4)
    assert difference > 0


def pixels_off(shown: tuple[OutlineModel, dict[int, ImageEvidence], Posed], at: Posed) -> float:
    """Return how far the true outline moves across itself to another pose, px (median)."""
    model, _, truth = shown
    drawn = model.draw(truth, 0)
    assert drawn is not None
    there, here = model.move(drawn, truth), model.move(drawn, at)
    assert there is not None
    assert here is not None
    return float(np.median(np.abs(((there.pixels - here.pixels) * drawn.normals).sum(axis=1))))


@pytest.mark.parametrize(("pixels", "far"), [(4, False), (30, True)])
def test_pose_is_found_from_as_far_away_as_edges_are_looked_for(
    shown: tuple[OutlineModel, dict[int, ImageEvidence], Posed], pixels: float, *, far: bool
) -> None:
    depth = float(shown[2].pose[2, 3])
    across = shown[2].pose[:3, :3].T @ [pixels * depth / 513, 0, 0]
    change = np.array([*across, 0, 0, 0, 0, 0, 0])
    assert pixels_off(shown, shown[2].moved(change)) > 0.4 * pixels
    found = fitted(shown, change, far=far)
    assert pixels_off(shown, found.at) < 0.6
    assert found.holds
    assert not found.doubts


def test_pose_that_is_too_far_away_is_not_supported(
    shown: tuple[OutlineModel, dict[int, ImageEvidence], Posed],
) -> None:
    depth = float(shown[2].pose[2, 3])
    across = shown[2].pose[:3, :3].T @ [60 * depth / 513, 0, 0]
    found = fitted(shown, np.array([*across, 0, 0, 0, 0, 0, 0]), far=False)
    assert found.doubts


def test_jaws_do_not_pass_each_other(shown: tuple[OutlineModel, dict[int, ImageEvidence], Posed]) -> None:
    """Jaws that are open by a negative angle have the outline of open ones, and exchanged tips."""
    model, _, at = shown
    names = model.instrument.joint_names
    jaw = names.index("jaw")
    change = np.zeros(6 + len(names))
    change[6 + jaw] = -2 * at.joints[jaw]
    assert at.joints[jaw] + change[6 + jaw] < -0.2
    found = fitted(shown, change, far=True)
    assert found.at.joints[jaw] > -LIMIT_SIGMA - 1e-9
