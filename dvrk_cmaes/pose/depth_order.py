"""Which of two tools that meet in an image is in front, from their poses.

What a tool hides of another cannot be told from the masks: the border between two labels is the outline of whichever
tool is nearer. The depths of the two surfaces tell it, where they differ by more than the poses are uncertain. Tools
may be interlocked, each in front of the other somewhere: then neither counts as in front.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import Bool, Float64, Indices, Posed
from dvrk_cmaes.pose.expected_error import jacobian
from dvrk_cmaes.pose.views import silhouette_of
from dvrk_cmaes.results.parts import posed
from dvrk_cmaes.results.result import Place, Result
from dvrk_cmaes.silhouette import Body

OPPOSITE: Final[dict[Place, Place]] = {
    "behind": "in front",
    "in front": "behind",
    "unclear": "unclear",
    "apart": "apart",
}
_LEAST_PROBABILITY: Final = 0.97  # of the right mode
_REACH: Final = 3  # px from both masks, within which they meet
_MOST: Final = 400  # pixels at which depths are compared
_SIGMAS: Final = 2.0  # standard deviations of the difference of the depths ...
_SHARE: Final = 0.05  # ... by which it differs from zero at all but this share of the pixels


def place_of_other(
    results: tuple[Result, Result], bodies: tuple[Body, Body], views: tuple[Sequence[SeenView], Sequence[SeenView]]
) -> Place:
    """Return where the second of two tools is, as seen by the first, in all views of a frame together.

    ``results`` and ``bodies`` are those of the tools, ``views`` those of the frame, with the mask of each tool. They
    must meet in at least one view in which both have a mask, and the one be clearly nearer wherever they meet in any
    view. It is unclear where a result has no pose, or one that is in the right mode with a probability of less than
    0.97, and where masks of a view differ in size.
    """
    if not all(_is_trusted(result) for result in results):
        return "unclear"
    first, second = (_placed(result, body) for result, body in zip(results, bodies, strict=True))
    shared = (pair for pair in zip(*views, strict=True) if all(view.given for view in pair))
    places = {_place_in_view(first, second, *pair) for pair in shared} - {"apart"}
    if not places:
        return "apart"
    return places.pop() if len(places) == 1 else "unclear"


def _is_trusted(result: Result) -> bool:
    """Whether a result has a pose with a covariance, which is not likely to be in a wrong mode."""
    if result.camera_from_root is None or result.covariance is None:
        return False
    return result.mode_probability is None or result.mode_probability >= _LEAST_PROBABILITY


_Tool = tuple[Body, Posed, Float64]
"""A tool's body, its pose, and the covariance (6 + J, 6 + J) of small changes of that."""


def _placed(result: Result, body: Body) -> _Tool:
    """Return a tool in the pose of its result, which has a covariance."""
    assert result.covariance is not None
    return body, posed(result, body.instrument.joint_names), result.covariance


def _depths(tool: _Tool, view: SeenView, pixels: Float64) -> tuple[Float64, Float64]:
    """Return the depths (N,) of a tool's surface at pixels (N, 2) of a view, m, infinite beside it, and variances, m^2.

    The variances follow from the covariance of the pose and the joints.
    """
    body, at, covariance = tool
    seen = at.seen_from(view.view_from_camera)
    links = body.camera_from_links(seen.pose[None], seen.joints[None])[0]
    directions = np.c_[view.camera.normalise(pixels), np.ones(len(pixels))]
    depth, owner = body.scenes.depths(links, directions)
    hit = np.isfinite(depth)
    variance = np.full(len(pixels), np.inf)
    points, owner = directions[hit] * depth[hit, None], owner[hit]
    centred = points - links[owner, :3, 3]
    in_link = np.einsum("nij,ni->nj", links[owner, :3, :3], centred)

    def moved_depth(at: Posed) -> Float64:
        moved = body.camera_from_links(at.pose, at.joints)[:, owner, 2]
        return np.asarray(np.einsum("cnj,nj->cn", moved[..., :3], in_link) + moved[..., 3])

    slope = jacobian(moved_depth, seen)
    variance[hit] = np.einsum("ni,ij,nj->n", slope, covariance, slope)
    return depth, variance


def _place_in_view(first: _Tool, second: _Tool, view: SeenView, of_second: SeenView) -> Place:
    """Return where the second tool is, as seen by the first, in one view; ``of_second`` has the mask of the second.

    Depths are compared where both silhouettes are, and where the masks meet, there with the nearest pixel of each
    silhouette.
    """
    if view.mask.shape != of_second.mask.shape:
        return "unclear"
    silhouettes = [silhouette_of(at, view, body) for body, at, _ in (first, second)]
    near = [_grown(seen.mask, _REACH) for seen in (view, of_second)]
    compared = np.argwhere((silhouettes[0] & silhouettes[1]) | (near[0] & near[1]))
    if len(compared) == 0:
        return "apart"
    if not all(silhouette.any() for silhouette in silhouettes):
        return "unclear"
    compared = compared[np.linspace(0, len(compared) - 1, min(_MOST, len(compared))).astype(int)]
    pairs = zip((first, second), silhouettes, strict=True)
    measured = [_depths(tool, view, _nearest(silhouette, compared)) for tool, silhouette in pairs]
    depths, variances = zip(*measured, strict=True)
    seen = np.isfinite(depths[0]) & np.isfinite(depths[1])
    if not seen.any():
        return "unclear"
    sigmas = (depths[1] - depths[0])[seen] / np.sqrt((variances[0] + variances[1])[seen])
    if np.quantile(sigmas, _SHARE) > _SIGMAS:
        return "behind"
    return "in front" if np.quantile(sigmas, 1 - _SHARE) < -_SIGMAS else "unclear"


def _grown(mask: Bool, radius: int) -> Bool:
    """Return a mask (H, W) grown by a number of pixels in all directions."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return cv2.dilate(mask.astype(np.uint8), kernel).astype(np.bool_)


def _nearest(silhouette: Bool, pixels: Indices) -> Float64:
    """Return the pixel (u, v) of a silhouette (H, W) that is nearest to each of some pixels (row, column), (N, 2)."""
    _, labels = cv2.distanceTransformWithLabels(
        (~silhouette).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    places = np.zeros((labels.max() + 1, 2))
    places[labels[silhouette]] = np.argwhere(silhouette)[:, ::-1]
    return np.asarray(places[labels[pixels[:, 0], pixels[:, 1]]])
