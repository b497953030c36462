"""A particle filter as a baseline: a random walk on the camera-to-base transform and on lumped offsets of the joints.

The state of a particle is a small change of camera_from_base, which also takes in the errors of the outer joints, and
an offset of each of the instrument's joints. Its weight in an image is that of its silhouette against the mask, a sum
of squared distances of the outline from the mask's contour, and of the markers that are seen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from worlds.folders import Folder
from worlds.motion import instrument_of

from benchmark.tasks import readings_of
from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.frames.markers import Marker, read_detections, read_marker_table
from dvrk_cmaes.geometry import Posed, inverse, moved
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.silhouette.renderer import PixelSums, Renderer

Float64 = NDArray[np.float64]

PARTICLES: Final = 1000
WIDTH: Final = 160
"""Width of the images in which silhouettes are compared, px."""
START: Final = np.array([0.002] * 3 + [0.05] * 3 + [0.10] * 3)
"""Standard deviations at the start: of the pose along and about the root's axes (m, rad), and of the joints (rad)."""
WALK: Final = np.array([0.0006] * 3 + [0.012] * 3 + [0.03] * 3)
"""Standard deviations of a step from one image to the next."""
EDGE_PX: Final = 1.0
"""Standard deviation of the mask's contour, px of the small image."""
EDGE_LENGTH: Final = 8.0
"""Length of contour, px of the small image, within which its errors are the same."""
MARKER_PX: Final = 3.0
"""Standard deviation of a marker's pixels in 640 x 480 pixels; that of the readings' errors is in it."""
_FARTHEST: Final = 8.0  # px of the small image, from which on distances count the same
_OUTLIER: Final = 3.0  # standard deviations, from which on a marker counts the same
_SEED: Final = 7


@dataclass(frozen=True, eq=False)
class Followed:
    """The mean of the particles in a frame: pose (4, 4), joints (J,), and their covariance (6 + J, 6 + J).

    The covariance includes a step of the random walk, so that it is not zero where one particle has all the weight.
    """

    frame: str
    pose: Float64
    joints: Float64
    covariance: Float64


def follow(given: Folder, first: str, start: Float64) -> Iterator[Followed]:
    """Follow the instrument from a frame on, in which its pose (4, 4) is roughly known.

    The changes of camera_from_base are about the root of the first frame, where they are smallest.
    """
    rng = np.random.default_rng([_SEED, given.world.number])
    instrument, camera = instrument_of(given.world.instrument), given.world.camera
    readings = readings_of(given, instrument)
    arm = base_from_root(readings.outer, given.world.arm, roll_offset=instrument.roll_offset)
    begin = given.names.index(first)
    size = (WIDTH, max(1, round(WIDTH * camera.height / camera.width)))
    renderer = Renderer(prepare(instrument), camera, threads=1).at(*size)
    table = read_marker_table(bundled_path("markers", "lnd.json"))
    detected = read_detections(given.path / "markers.csv")
    marker_px = MARKER_PX * camera.width / 640

    state = START * rng.standard_normal((PARTICLES, len(START)))
    for number in range(begin, given.frames):
        name = given.names[number]
        if number > begin:
            state = state + WALK * rng.standard_normal(state.shape)
        particles = Posed(
            moved(start, state[:, :6]) @ (inverse(arm[begin]) @ arm[number]), readings.joints[number] + state[:, 6:]
        )
        misfit = _edges(given, name, size, renderer, particles)
        for marker, pixel in detected.get(name, {}).items():
            off = camera.project(_placed(instrument, table[marker], particles)) - pixel
            misfit += np.minimum((off**2).sum(axis=1) / marker_px**2, _OUTLIER**2)
        weights = np.exp(-(misfit - misfit.min()) / 2)
        weights /= weights.sum()
        best = particles[int(np.argmax(weights))]
        changes = particles.minus(best)
        mean = weights @ changes
        spread = (weights[:, None] * (changes - mean)).T @ (changes - mean)
        found = best.moved(mean)
        yield Followed(name, found.pose, found.joints, spread + np.diag(WALK**2))
        drawn = np.searchsorted(np.cumsum(weights), (np.arange(PARTICLES) + rng.random()) / PARTICLES)
        state = state[np.minimum(drawn, PARTICLES - 1)]


def _placed(instrument: Instrument, marker: Marker, particles: Posed) -> Float64:
    """Return the position (C, 3) of a marker in the camera, m, for C particles."""
    link = next((k for k, joint in enumerate(instrument.chain.joints) if joint.child == marker.link), -1)
    pose = particles.pose @ instrument.chain.forward(particles.joints, [link])[:, 0]
    return np.asarray(pose[:, :3, :3] @ marker.position + pose[:, :3, 3])


def _edges(given: Folder, name: str, size: tuple[int, int], renderer: Renderer, particles: Posed) -> Float64:
    """Return for C poses the sum of the squared distances of their outlines from the mask's contour, in variances.

    Between outline and contour the distance from the contour is summed: half of its square for each pixel of contour.
    """
    label = 1 if given.world.tools > 1 else None
    mask = read_mask(given.path / "masks" / f"{name}.png", label=label).astype(np.float32)
    small = cv2.resize(mask, size, interpolation=cv2.INTER_AREA) > 0.5
    inside = cv2.distanceTransform(small.astype(np.uint8), cv2.DIST_L2, 5)
    outside = cv2.distanceTransform((~small).astype(np.uint8), cv2.DIST_L2, 5)
    distance = np.minimum(outside, _FARTHEST) - np.minimum(inside, _FARTHEST)
    ignored = given.ignored / f"{name}.png"
    if ignored.exists():
        distance[cv2.resize(read_mask(ignored).astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0] = 0.0
    within = renderer.sums(particles.pose, particles.joints, PixelSums.of(distance[None]))[:, 0]
    between = within - distance[small].sum()
    return np.asarray(2 * between / (EDGE_PX**2 * EDGE_LENGTH))
