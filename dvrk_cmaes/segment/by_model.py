"""Search of an image for instruments by their model: poses whose silhouettes the picture itself bears out.

Pairs of straight edges give axes of the shaft. Along each axis the instrument is tried at steps, straight, from both
ends; the best places are tried at all rolls and at some angles of the wrist, or at those that are read; the best of
these are optimised. What a picture tells of a candidate is in `appearance`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Posed, frame_along, rotation_about_z, transform
from dvrk_cmaes.pose.search import minimise_each
from dvrk_cmaes.segment.appearance import Appearance
from dvrk_cmaes.segment.shaft_pairs import Pair, find_pairs
from dvrk_cmaes.segment.sizes import resized, shrunk, size_within
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import decimated_body

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
Image = NDArray[np.uint8]

_REDUCED: Final = 320  # px, longer side at which candidates are compared
_LINES: Final = 800  # px, longer side at which edges are looked for
_DETAIL: Final = 0.0015  # m, cells of the meshes
_PAIRS: Final = 28
_STEP: Final = 5.0  # px along an axis
_MOST_STEPS: Final = 40
_GROUPED: Final = 240  # best places along axes
_GROUPS: Final = 5  # of places, each an instrument
_PLACES: Final = 6  # of a group, that are tried at all rolls and wrists
_ROLLS: Final = 8
_JAW: Final = 0.5  # rad, where none is read
_BENDS: Final = np.deg2rad([(0, 0), (45, 0), (-45, 0), (0, 45), (0, -45), (35, 35), (-35, 35), (0, 75), (0, -75)])
"""Wrist pitch and yaw that are tried without readings."""
_JAWS: Final = (0.4,)
_STARTS: Final = 2  # of a group
_EVALUATIONS: Final = 160
_SCALE: Final = np.array([1e-3, 1e-3, 4e-3, np.deg2rad(4), np.deg2rad(4), np.deg2rad(15)])
_SEED: Final = 0
_STRAIN: Final = 0.01  # of the score, for each squared unit of change
_EVEN, _STEEPNESS = 1.6, 3.0  # score at which right and wrong are as likely, and slope of the log-odds there
_SHARED: Final = 0.25  # of the smaller silhouette, that two candidates of different instruments may share


@dataclass(frozen=True, eq=False)
class Candidate:
    """An instrument found in a picture: where it is, how well the picture bears it out, and its silhouette (h, w)."""

    at: Posed
    score: float
    parts: tuple[float, ...]
    silhouette: Bool

    @property
    def confidence(self) -> float:
        """Probability that it is an instrument, by its score."""
        return float(1 / (1 + np.exp(-_STEEPNESS * (self.score - _EVEN))))


def assumed_camera(width: int, height: int) -> Camera:
    """Return the camera that is assumed for an image without one: of an endoscope, without distortion."""
    focal = 1.0 * max(width, height)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def find_instruments(
    image: Image, outside: Bool, body: Body, camera: Camera, joints: Mapping[str, float] | None = None, most: int = 4
) -> list[Candidate]:
    """Find the instruments in an image (H, W, 3) uint8 BGR, the best first; their silhouettes do not share pixels.

    ``outside`` (H, W) are pixels outside the picture; ``joints`` are the readings, rad, by name.
    """
    instrument = body.instrument
    if instrument.shaft is None:
        return []
    (fine, _), (size, _) = (size_within(image.shape, longest) for longest in (_LINES, _REDUCED))
    lines, small = shrunk(image, _LINES).max(axis=2), shrunk(image, _REDUCED)
    pairs = find_pairs(lines, camera.scaled(*fine), instrument.shaft.radius, resized(outside, fine), _PAIRS)
    if not pairs:
        return []
    coarse = camera.scaled(*size)
    decimated = decimated_body(body, _DETAIL)
    appearance = Appearance(small, coarse, decimated, resized(outside, size))
    read = np.array([np.nan if joints is None else joints.get(name, np.nan) for name in instrument.joint_names])
    jaw = np.array([name == "jaw" for name in instrument.joint_names])
    straight = np.where(np.isnan(read), np.where(jaw, _JAW, 0.0), read)
    places = _along(pairs, coarse)
    tried = Posed(places, np.tile(straight, (len(places), 1)))
    renderer = Renderer(decimated, coarse, threads=1)
    groups = _grouped(tried, appearance.scores(tried).total, renderer)
    turned = [_turned(tried[group], read, jaw, instrument.joint_names) for group in groups]
    scores = [appearance.scores(each).total for each in turned]
    starts = [_distinct(each, own, coarse, _STARTS, near=4.0) for each, own in zip(turned, scores, strict=True)]
    begin = Posed.stacked([each[k] for each, own in zip(turned, starts, strict=True) for k in own])
    known = [-float(own[k]) for own, each in zip(scores, starts, strict=True) for k in each]
    scale = np.concatenate([_SCALE, np.where(np.isnan(read), 0.35, 0.08)])

    def loss(index: NDArray[np.intp], change: Float64) -> Float64:
        strain = _STRAIN * (change**2).sum(axis=1)
        return np.asarray(strain - appearance.scores(begin[index].moved(change * scale)).total)

    found = minimise_each("cmaes", loss, known, len(scale), _EVALUATIONS, _SEED)
    ends = Posed.stacked([begin[k].moved(each.best * scale) for k, each in enumerate(found)])
    measured = appearance.scores(ends)
    masks = renderer.masks(ends.pose, ends.joints)
    kept: list[Candidate] = []
    for k in np.argsort(-measured.total, kind="stable").tolist():
        if len(kept) == most:
            break
        if masks[k].any() and not any(_share(masks[k], each.silhouette) for each in kept):
            kept.append(Candidate(ends[k], float(measured.total[k]), measured.of(k), masks[k]))
    return kept


def _share(first: Bool, second: Bool) -> bool:
    """Whether two silhouettes (h, w) share more pixels than those of two instruments may."""
    return int((first & second).sum()) > _SHARED * min(int(first.sum()), int(second.sum()))


def _grouped(at: Posed, scores: Float64, renderer: Renderer) -> list[list[int]]:
    """Return the best places in groups, of which each is one instrument: those that share pixels with its first one."""
    best = np.argsort(-scores, kind="stable")[:_GROUPED]
    masks = renderer.masks(at.pose[best], at.joints[best])
    groups: list[tuple[Bool, list[int]]] = []
    for k, mask in zip(best.tolist(), masks, strict=True):
        if not mask.any():
            continue
        own = next((members for first, members in groups if _share(mask, first)), None)
        if own is None and len(groups) < _GROUPS:
            groups.append((mask, [k]))
        elif own is not None:
            own.append(k)
    parts = [np.array(members) for _, members in groups]
    chosen = [_distinct(at[part], scores[part], renderer.camera, _PLACES) for part in parts]
    return [part[own].tolist() for part, own in zip(parts, chosen, strict=True)]


def _along(pairs: list[Pair], camera: Camera) -> Float64:
    """Return poses (N, 4, 4) along the axes of pairs, both ways."""
    poses = []
    focal = float(np.sqrt(camera.fx * camera.fy))
    for pair in pairs:
        ends = [pair.point + at * pair.direction for at in (pair.begin, pair.end)]
        shown = [focal * end[:2] / max(end[2], 1e-3) for end in ends]
        steps = int(np.clip(np.hypot(*(shown[1] - shown[0])) / _STEP, 4, _MOST_STEPS))
        # equal steps in the image: of the inverse depth
        share = np.linspace(0, 1, steps)
        depth = np.maximum([ends[0][2], ends[1][2]], 1e-3)
        share = share * depth[0] / (share * depth[0] + (1 - share) * depth[1])
        at = pair.begin + share * (pair.end - pair.begin)
        for sign in (1.0, -1.0):
            rotation = frame_along(sign * pair.direction)
            origins = pair.point + at[:, None] * pair.direction
            poses.append(transform(np.tile(rotation, (steps, 1, 1)), origins))
    return np.concatenate(poses)


def _turned(places: Posed, read: Float64, jaw: Bool, names: tuple[str, ...]) -> Posed:
    """Return places at all rolls, a little before and behind, at the joints that are read or at some angles."""
    rolls = transform(rotation_about_z(np.arange(_ROLLS) * 2 * np.pi / _ROLLS), np.zeros((_ROLLS, 3)))
    bends = _BENDS if np.isnan(read[~jaw]).any() else np.zeros((1, 2))
    rows = []
    for bend in bends:
        for opening in _JAWS if np.isnan(read[jaw]).any() else (0.0,):
            row = read.copy()
            for k, name in enumerate(names):
                if np.isnan(row[k]):
                    row[k] = opening if jaw[k] else bend[0] if name == "wrist_pitch" else bend[1]
            rows.append(row)
    table = np.array(rows)
    poses = places.pose[:, None] @ rolls[None]
    poses = np.repeat(poses.reshape(-1, 4, 4), len(table), axis=0)
    return Posed(poses, np.tile(table, (len(poses) // len(table), 1)))


def _distinct(at: Posed, scores: Float64, camera: Camera, most: int, near: float = 9.0) -> list[int]:
    """Return the candidates with the largest scores that are not near a better one in the image, in place and roll."""
    focal = float(np.sqrt(camera.fx * camera.fy))
    kept: list[int] = []
    for k in np.argsort(-scores, kind="stable")[:4000].tolist():
        if len(kept) == most:
            break
        pose = at.pose[k]
        if all(
            np.hypot(*(focal * (pose[:2, 3] / pose[2, 3] - at.pose[j][:2, 3] / at.pose[j][2, 3]))) > near
            or np.linalg.norm(pose[:3, :3] - at.pose[j][:3, :3]) > 0.7
            or np.abs(at.joints[k] - at.joints[j]).max() > 0.6
            or abs(np.log(pose[2, 3] / at.pose[j][2, 3])) > 0.15
            for j in kept
        ):
            kept.append(k)
    return kept
