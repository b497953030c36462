"""Search of an image for instruments by their model: poses whose silhouettes the picture itself bears out.

Pairs of straight edges give axes of the shaft. Along each axis the instrument is tried at steps, from both ends, and
the best places with the wrist bent; the best places of each instrument are tried at all rolls and at some angles of the
wrist, or at those that are read; the best of these at other distances and tilts, and then improved step by step.
Nothing is drawn by chance. The likelihood of a candidate is in `appearance`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.frames.seen_view import overlap_of
from dvrk_cmaes.geometry import Bool, Float32, Float64, Image, Posed, frame_along, rotation_about_z, transform
from dvrk_cmaes.segment.appearance import Appearance, Scores
from dvrk_cmaes.segment.colours import brightest
from dvrk_cmaes.segment.prompts import Prompts
from dvrk_cmaes.segment.regions import REDUCED, resized, shrunk, size_within
from dvrk_cmaes.segment.segmentation import GUESS, Pixel
from dvrk_cmaes.segment.shaft_pairs import Pair, find_pairs, pair_of_mask
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import decimated_body

_RANKED: Final = 160  # px, longer side at which places are ranked
_LINES: Final = 800  # px, longer side at which edges are looked for
_DETAILS: Final = 0.0015, 0.002, 0.003, 0.004, 0.005, 0.006  # m, cells of the meshes
_FACES: Final = 260, 520  # at most, of the meshes that are ranked, and of those that are compared
_PAIRS: Final = 28
_MOST_PAIRS: Final = 280  # of which those that pass near prompts are taken
_NEAR_PROMPT: Final = 1.5  # widths of the shaft from its axis to a point on the instrument
_STEP: Final = 8.0  # px along an axis
_MOST_STEPS: Final = 24
_TRIED: Final = 200  # points along an axis, that are compared with prompts
_OF_AXIS: Final = 3  # best places along an axis, each way, that are two steps apart or more, and
_BENT: Final = 80  # best ones of all these, that are turned and bent
_FIRST_BENDS: Final = np.deg2rad([(0, 0), (50, 0)])  # there, without readings
_FIRST_ROLLS: Final = 4, 8  # there, without and with readings of the wrist
_GROUPS: Final = 5  # of places, each an instrument
_TURNED: Final = 288  # of a group: places, rolls and wrists that are tried
_ROLLS: Final = 8, 16  # without, and with readings of the wrist
_JAW: Final = 0.5  # rad, where none is read
_BENDS: Final = np.deg2rad([(0, 0), (45, 0), (-45, 0), (0, 45), (0, -45), (35, 35), (-35, 35), (0, 75), (0, -75)])
"""Wrist pitch and yaw that are tried without readings."""
_STARTS: Final = 4, 2  # places of a group, and turns of each, at most
_BEGUN: Final = 6  # of these, that are optimised, once they are at their best distance and tilt,
_BEHIND: Final = 0.6  # unless their score is less than the best one's by this
_INSTRUMENTS: Final = 3  # that are looked at further
_MOST: Final = 4  # that are returned
_ENDS: Final = 4, 2  # of each, that are optimised further, twice
_PASSES: Final = {False: (2, 4, 6), True: (4, 6, 10)}
"""Of the first, second and last optimisation, without and with a background."""
_OTHERS: Final = 2.2  # by which the score of another instrument may be less than the best one's
_ALIKE: Final = 0.85  # overlap of silhouettes of which the worse one is no further end
_SHARES: Final = np.array([0.4, 0.7, 1.0])  # of the way to the peak of the parabolas
_SCALE: Final = np.array([7e-4, 4e-3, 4e-3, np.deg2rad(10), np.deg2rad(2), np.deg2rad(15)])
"""Usual changes of a pose, m and rad: to the side in the image, in depth, along the shaft; tilt in depth, turn in the
image, roll."""
_DISTANCES: Final = 0.9, 1.0, 1.1  # of that of a start, that are tried, as edges measure a shaft's width roughly
_TILTS: Final = np.deg2rad([-16.0, -8.0, 0.0, 8.0, 16.0])  # and tilts in depth, which they measure by small differences
_SLIDES: Final = np.arange(-0.012, 0.031, 0.003)  # m along the shaft, by which finalists are moved
_STRAIN: Final = 0.01  # of the score, for each squared unit of change
_USUAL: Final = 95  # percentile of the scores along all axes, over which a candidate's margin is measured
_LOG_ODDS: Final = np.array([5.9, 2.1, 1.8, -0.1, 0.2, 1.1, -15.0])
"""Of a candidate that is an instrument, for each of its measures, its margin and its score, and in all.

Fitted by logistic regression to 92 candidates in 61 pictures: drawn in colour and in grey, of tissue, of a printed
board. Those of tissue count up to six times.
"""
_OF_GUESS: Final = 1.0  # by which the score of a guess must be larger than that of a candidate that is none
_NEAR_FOREGROUND: Final = 0.015  # of the longer side, from what differs from a background, where edges are looked for
_CLEARLY_BEHIND: Final = -1.5  # log-odds of pixels that are background
_EXPECTED: Final = np.array([0.02] * 3 + np.deg2rad([30, 30, 60]).tolist())
"""Usual deviations of a pose from the expected one, in the root's axes, m and rad."""
_SHARED: Final = 0.25  # of the smaller silhouette, that two candidates of different instruments may share


@dataclass(frozen=True, eq=False)
class Candidate:
    """An instrument found in a picture: where it is, and its silhouette (h, w).

    score : what the search makes large. confidence : probability that it is an instrument, and this its silhouette, by
    the measures of `appearance.Scores`, the score and its margin over that of most places; with a known background, how
    well the silhouette explains what differs from it there.
    """

    at: Posed
    score: float
    confidence: float
    silhouette: Bool


def assumed_camera(width: int, height: int) -> Camera:
    """Return the camera that is assumed for an image without one: of an endoscope, without distortion."""
    focal = 1.0 * max(width, height)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def find_instruments(
    image: Image,
    prompts: Prompts,
    body: Body,
    camera: Camera,
    joints: Mapping[str, float] | None = None,
    rough: Bool | None = None,
    foreground: Float32 | None = None,
    expected: Posed | None = None,
) -> list[Candidate]:
    """Find the instruments in an image (H, W, 3) uint8 BGR; their silhouettes do not share pixels.

    In the order of `rank`; where a pose is ``expected`` the one nearest to that is first, about which the instrument is
    looked for, too.

    ``joints`` are the readings, rad, by name. ``rough`` is a mask of any size found by other means: it is looked
    whether its sides are a shaft's, too. ``foreground`` are log-odds of instrument by a known background, of any size.
    Edges are looked for within a box; axes of the shaft that do not pass near points on the instrument are left out.
    """
    pairs = _pairs_in(image, prompts, body, camera, rough, foreground)
    if not pairs:
        return []
    search = _Search(image, prompts.outside, body, camera, joints, foreground)
    begin, usual = search.starts(_along(pairs, search.camera))
    if expected is not None:
        varied = _varied(expected[None])
        begin.append(varied[_ordered(search.compared.scores(varied).total)[:_BEGUN]])
    if not begin:
        return []
    at = _joined(begin)
    *first, last = _PASSES[foreground is not None]
    for passes, ends in zip(first, _ENDS, strict=True):
        at, _, _, groups = search.improved(at, passes, _INSTRUMENTS, ends)
        if not groups:
            return []
        at = at[[k for group in groups for k in group]]
    at, _ = _best_of_each(search.ranked, [_slid(at[k], _ROLLS[0]) for k in range(len(at))])
    at, scores, masks, groups = search.improved(at, last, _MOST, 1)
    measures = np.c_[scores.measures, scores.total - usual, scores.total, np.ones(len(at))]
    sure = 1 / (1 + np.exp(-measures @ _LOG_ODDS))
    if foreground is not None:
        sure = np.array([_explained(mask, foreground) for mask in masks])
    found = [Candidate(at[k], float(scores.total[k]), float(sure[k]), masks[k]) for (k,) in groups]
    if expected is not None:
        return sorted(found, key=lambda each: float(np.square(each.at.minus(expected)[:6] / _EXPECTED).sum()))
    return sorted(found, key=lambda each: rank(each.score, each.confidence), reverse=True)


def rank(score: float, confidence: float) -> float:
    """Return by what candidates are ordered, given a score and a confidence: a guess needs a clearly larger score."""
    return score - _OF_GUESS * (confidence < GUESS)


def _pairs_in(
    image: Image, prompts: Prompts, body: Body, camera: Camera, rough: Bool | None, foreground: Float32 | None
) -> list[Pair]:
    """Return the pairs of lines that may be a shaft's edges in an image, arguments as of `find_instruments`."""
    if body.instrument.shaft is None:
        return []
    radius, most = body.instrument.shaft.radius, _MOST_PAIRS if prompts.given else _PAIRS
    size, _ = size_within(image.shape, _LINES)
    unseen = prompts.background
    if foreground is not None:
        unseen = unseen | ~resized(_near_foreground(foreground), unseen.shape[1::-1])
    lines = brightest(shrunk(image, _LINES))
    pairs = find_pairs(lines, camera.scaled(*size), radius, resized(unseen, size), most)
    pairs = [pair for pair in pairs if _passes_near(pair, prompts.points, camera, radius)][:_PAIRS]
    pair = None if rough is None else pair_of_mask(rough, camera.scaled(*rough.shape[1::-1]), radius)
    return pairs if pair is None else [*pairs, pair]


class _Search:
    """Search of an image for an instrument: likelihoods at the size at which places are ranked and at the larger one.

    ``camera`` is that of the larger one, ``read`` (J,) are the readings, rad, NaN without one.
    """

    def __init__(
        self,
        image: Image,
        outside: Bool,
        body: Body,
        camera: Camera,
        joints: Mapping[str, float] | None,
        foreground: Float32 | None,
    ) -> None:
        meshes = [_with_few_faces(body, faces) for faces in _FACES]
        self.camera, self._names = camera.scaled(*size_within(image.shape, REDUCED)[0]), body.instrument.joint_names
        self.ranked = _appearance(image, outside, meshes[0], camera, _RANKED, foreground)
        self.compared = _appearance(image, outside, meshes[1], camera, REDUCED, foreground)
        self._renderer = Renderer(meshes[1], self.camera, threads=1)
        self.read = np.array([(joints or {}).get(name, np.nan) for name in self._names])
        self._bent = any(np.isnan(value) for value, name in zip(self.read, self._names, strict=True) if name != "jaw")

    def _turns(self, counts: tuple[int, int], bends: Float64) -> Posed:
        """Return some rolls, at the joints that are read or at some bends (B, 2) of pitch and yaw."""
        tried = bends if self._bent else np.zeros((1, 2))
        angles = [[{"jaw": _JAW, "wrist_pitch": bend[0]}.get(name, bend[1]) for name in self._names] for bend in tried]
        joints = np.where(np.isnan(self.read), angles, self.read)
        rolls = _rolls(counts[not self._bent])
        return Posed(np.repeat(rolls, len(joints), axis=0), np.tile(joints, (len(rolls), 1)))

    def starts(self, axes: list[Float64]) -> tuple[list[Posed], float]:
        """Return the poses along axes (N, 4, 4) from which each instrument is optimised, and the score of most places.

        Of the best places, turned and bent, each instrument's are tried at all turns, the best of these at other
        distances and tilts. Instruments whose best place scores less than most are left out.
        """
        places = np.concatenate(axes)
        tried = Posed(places, np.tile(self._turns((1, 1), np.zeros((1, 2))).joints, (len(places), 1)))
        scored = self.ranked.scores(tried).total
        usual = float(np.percentile(scored, _USUAL))
        best = np.array(_best_along(axes, scored))
        tried = tried[best[_ordered(scored[best])[:_BENT]]]
        bends = _turned(tried.pose, self._turns(_FIRST_ROLLS, _FIRST_BENDS))
        scored = self.ranked.scores(bends).total.reshape(len(tried), -1).max(axis=1)
        every, begin = self._turns(_ROLLS, _BENDS), list[Posed]()
        masks, apart = self._renderer.masks(tried.pose, tried.joints), _Apart(tried, self.camera, 5.0)
        for group in _grouped(masks, scored, _GROUPS, _TURNED // len(every.pose), apart):
            if begin and scored[group[0]] < usual:
                break
            at = _turned(tried.pose[group], every)
            chosen = _starts(at, self.ranked.scores(at).total, len(every), self.camera)
            varied, own = _best_of_each(self.compared, [_varied(at[[k]]) for k in chosen])
            begin.append(varied[[k for k in _ordered(own)[:_BEGUN] if own[k] > own.max() - _BEHIND]])
        return begin, usual

    def improved(self, begin: Posed, passes: int, most: int, ends: int) -> tuple[Posed, Scores, Bool, list[list[int]]]:
        """Return better poses, their scores and silhouettes, and which of them are the ends of an instrument."""
        scale = np.concatenate([_SCALE, np.where(np.isnan(self.read), 0.35, 0.08)])
        at = _optimised(self.compared, begin, scale, passes)
        scores, masks = self.compared.scores(at), self._renderer.masks(at.pose, at.joints)
        groups = _grouped(masks, scores.total, most, ends, partial(_are_unlike, masks))
        return at, scores, masks, [group for group in groups if scores.total[group[0]] > scores.total.max() - _OTHERS]


def _passes_near(pair: Pair, points: Sequence[Pixel], camera: Camera, radius: float) -> bool:
    """Whether the axis of a pair passes near all points on the instrument."""
    axis = pair.point + np.linspace(pair.begin, pair.end, _TRIED)[:, None] * pair.direction
    pixels, near = camera.project(axis), _NEAR_PROMPT * 2 * radius * camera.fx / axis[:, 2]
    return all(bool((np.linalg.norm(pixels - point, axis=1) < near).any()) for point in points)


def _optimised(by: Appearance, begin: Posed, scale: Float64, passes: int) -> Posed:
    """Improve the scores of N poses by changes whose usual sizes are ``scale`` (D,), those of `_SCALE` and of joints.

    In each pass of a pose, each change is tried both ways, and the peak of the parabolas through these. The best of all
    is taken; where none is better, later steps are half as long.
    """
    count, dimension = len(begin.pose), len(scale)
    change, step, known = np.zeros((count, dimension)), np.ones((count, 1, 1)), by.scores(begin).total
    both, ways = np.concatenate([np.eye(dimension), -np.eye(dimension)]), _ways(begin, scale)

    def scores(tried: Float64) -> Float64:
        at = begin[np.repeat(np.arange(count), tried.shape[1])].moved((tried @ ways).reshape(-1, dimension))
        return np.asarray(by.scores(at).total.reshape(count, -1) - _STRAIN * (tried**2).sum(axis=2))

    for _ in range(passes):
        tried = change[:, None] + step * both
        found = scores(tried)
        more, less = found[:, :dimension], found[:, dimension:]
        slope, bend = (more - less) / 2, 2 * known[:, None] - more - less
        peak = np.clip(np.where(bend > 0, slope / np.maximum(bend, 1e-9), 2 * np.sign(slope)), -2, 2)
        further = change[:, None] + step * _SHARES[:, None] * peak[:, None]
        tried, found = np.concatenate([tried, further], axis=1), np.concatenate([found, scores(further)], axis=1)
        best = np.arange(count), found.argmax(axis=1)
        better = found[best] > known
        change[better], known[better] = tried[best][better], found[best][better]
        step[~better] /= 2
    return begin.moved((change[:, None] @ ways)[:, 0])


def _ways(at: Posed, scale: Float64) -> Float64:
    """Return the changes (N, D, D) of N poses in their own axes, natural in images, of sizes ``scale`` (D,)."""
    seen = (at.pose[:, :3, 3][:, None] @ at.pose[:, :3, :3])[:, 0, :2]
    away = seen / np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-9)
    across = away[:, ::-1] * (-1, 1)
    ways = np.tile(np.diag(scale), (len(at), 1, 1))
    for first in (0, 3):
        ways[:, first, first : first + 2] = scale[first] * across
        ways[:, first + 1, first : first + 2] = scale[first + 1] * away
    return ways


def _best_of_each(by: Appearance, sets: Sequence[Posed]) -> tuple[Posed, Float64]:
    """Return the best pose of each of N sets of equally many poses, and their scores (N,)."""
    every = _joined(sets)
    scores = by.scores(every).total.reshape(len(sets), -1)
    best = scores.argmax(axis=1)
    return every[best + np.arange(len(sets)) * scores.shape[1]], scores.max(axis=1)


def _varied(at: Posed) -> Posed:
    """Return one pose at several distances from the camera, and tilted there."""
    near = [np.concatenate([at.pose[0, :, :3], factor * at.pose[0, :, 3:]], axis=1) for factor in _DISTANCES]
    poses = Posed(np.stack(near), np.tile(at.joints, (len(near), 1)))
    poses.pose[:, 3, 3] = 1.0
    tilt = _ways(poses, np.ones(6 + at.joints.shape[1]))[:, 3]
    return _joined([poses.moved(angle * tilt) for angle in _TILTS])


def _joined(sets: Sequence[Posed]) -> Posed:
    """Return the poses of some sets as one."""
    return Posed(np.concatenate([each.pose for each in sets]), np.concatenate([each.joints for each in sets]))


def _appearance(
    image: Image, outside: Bool, drawn: Body, camera: Camera, longest: int, foreground: Float32 | None
) -> Appearance:
    """Return the likelihoods of an image with at most some px as longer side, by some meshes of the instrument."""
    size, _ = size_within(image.shape, longest)
    before = None
    if foreground is not None:
        before = np.asarray(cv2.resize(foreground, size, interpolation=cv2.INTER_AREA), np.float32)
    return Appearance(shrunk(image, longest), camera.scaled(*size), drawn, resized(outside, size), before)


def _explained(silhouette: Bool, foreground: Float32) -> float:
    """Return how well a silhouette (h, w) explains what differs from a background where it is, 0 to 1.

    This is the share of these pixels that it covers, times the share of its own pixels that are not clearly background.
    """
    size = silhouette.shape[1::-1]
    odds = np.asarray(cv2.resize(foreground, size, interpolation=cv2.INTER_AREA))
    differs = (odds > 1).astype(np.uint8)
    count, labels = cv2.connectedComponents(differs, connectivity=8)
    touched = np.bincount(labels[silhouette], minlength=count) > 0
    touched[0] = False
    region = touched[labels]
    if not region.any():
        return 0.0
    return float((region & silhouette).sum() / region.sum() * (odds[silhouette] > _CLEARLY_BEHIND).mean())


def _near_foreground(foreground: Float32) -> Bool:
    """Return the pixels (h, w) that are near those whose log-odds of instrument (h, w) are clear."""
    size = 2 * round(_NEAR_FOREGROUND * max(foreground.shape)) + 1
    clear = cv2.morphologyEx((foreground > 1).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return np.asarray(cv2.dilate(clear, np.ones((size, size), np.uint8)) > 0)


def _with_few_faces(body: Body, faces: int) -> Body:
    """Return a body with at most some faces, or as few as the coarsest meshes have."""
    for cell in _DETAILS:
        found = decimated_body(body, cell)
        if sum(len(link.faces) for link in found.instrument.links) <= faces:
            break
    return found


def _are_unlike(masks: Bool, first: int, second: int) -> bool:
    """Whether two of some silhouettes (N, h, w) differ clearly."""
    return overlap_of(masks[first], masks[second]) <= _ALIKE


def _chosen(order: Sequence[int], most: int, apart: Callable[[int, int], bool]) -> list[int]:
    """Return at most some of the numbers, in their order, each of which is ``apart`` from those before."""
    chosen: list[int] = []
    for k in order:
        if len(chosen) < most and all(apart(k, j) for j in chosen):
            chosen.append(k)
    return chosen


def _ordered(scores: Float64) -> list[int]:
    """Return the places of scores, the largest first."""
    return [int(k) for k in np.argsort(-scores, kind="stable")]


def _grouped(
    masks: Bool, scores: Float64, most: int, members: int, apart: Callable[[int, int], bool]
) -> list[list[int]]:
    """Return the best poses in groups, of which each is one instrument: those that share pixels with its first one.

    ``masks`` (N, h, w) are their silhouettes. Of poses of a group that are not ``apart`` only the best one is kept.
    """
    areas = np.count_nonzero(masks, axis=(1, 2))

    def share(k: int, j: int) -> bool:
        return bool(np.count_nonzero(masks[k] & masks[j]) > _SHARED * min(areas[k], areas[j]))

    left, groups = [k for k in _ordered(scores) if areas[k]], []
    for _ in range(most):
        own = [k for k in left if share(k, left[0])]
        left = [k for k in left if k not in own]
        groups += [_chosen(own, members, apart)] if own else []
    return groups


def _along(pairs: list[Pair], camera: Camera) -> list[Float64]:
    """Return poses (N, 4, 4) along the axis of each pair, one way and then the other."""
    poses = []
    focal = float(np.sqrt(camera.fx * camera.fy))
    for pair in pairs:
        ends = pair.point + np.array([[pair.begin], [pair.end]]) * pair.direction
        near, far = depths = np.maximum(ends[:, 2], 1e-3)
        shown = focal * ends[:, :2] / depths[:, None]
        steps = int(np.clip(np.hypot(*(shown[1] - shown[0])) / _STEP, 4, _MOST_STEPS))
        share = np.linspace(0, 1, steps)[:, None]  # equal steps in the image: of the inverse depth
        origins = ends[0] + share * near / (share * near + (1 - share) * far) * (ends[1] - ends[0])
        ways = (frame_along(sign * pair.direction) for sign in (1.0, -1.0))
        poses += [transform(np.tile(rotation, (steps, 1, 1)), origins) for rotation in ways]
    return poses


def _best_along(axes: list[Float64], scores: Float64) -> list[int]:
    """Return the best places along each axis, given the poses along each and the scores of all."""
    parts = np.split(np.arange(len(scores)), np.cumsum([len(poses) for poses in axes])[:-1])
    orders = (places[_ordered(scores[places])].tolist() for places in parts)
    return [k for order in orders for k in _chosen(order, _OF_AXIS, lambda k, j: abs(k - j) > 1)]


def _rolls(count: int) -> Float64:
    """Return turns (R, 4, 4) about the shaft by equal angles."""
    return transform(rotation_about_z(np.arange(count) * 2 * np.pi / count), np.zeros((count, 3)))


def _slid(at: Posed, count: int) -> Posed:
    """Return a pose, the first, and those moved along the shaft, at each place turned by some rolls."""
    steps = np.concatenate([[0.0], _SLIDES])
    places = np.tile(at.pose, (len(steps), 1, 1))
    places[:, :3, 3] += steps[:, None] * at.pose[:3, 2]
    return _turned(places, Posed(_rolls(count), np.tile(at.joints, (count, 1))))


def _turned(places: Float64, turns: Posed) -> Posed:
    """Return places (N, 4, 4), each at all turns about its own axis and with their joints."""
    poses = (places[:, None] @ turns.pose[None]).reshape(-1, 4, 4)
    return Posed(poses, np.tile(turns.joints, (len(places), 1)))


def _starts(at: Posed, scores: Float64, turns: int, camera: Camera) -> list[int]:
    """Return the best turns of the best places, given places each at all turns: the best one may be wrong."""
    starts: list[int] = []
    for place in _ordered(scores.reshape(-1, turns).max(axis=1))[: _STARTS[0]]:
        order = [turns * place + k for k in _ordered(scores[turns * place : turns * (place + 1)])]
        starts += _chosen(order, _STARTS[1], _Apart(at, camera, 8.0))
    return starts


@dataclass(frozen=True, eq=False)
class _Apart:
    """Whether two of some poses are apart: in the image by more than ``near`` px, in roll, joints or depth."""

    at: Posed
    camera: Camera
    near: float

    def __call__(self, first: int, second: int) -> bool:
        pose, other = self.at.pose[[first, second]]
        away = np.sqrt(self.camera.fx * self.camera.fy) * (pose[:2, 3] / pose[2, 3] - other[:2, 3] / other[2, 3])
        return bool(
            np.hypot(*away) > self.near
            or np.linalg.norm(pose[:3, :3] - other[:3, :3]) > 0.7
            or np.abs(self.at.joints[first] - self.at.joints[second]).max() > 0.6
            or abs(np.log(pose[2, 3] / other[2, 3])) > 0.15
        )
