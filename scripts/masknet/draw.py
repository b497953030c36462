"""Draw the layers from which training pictures are composed: what rays meet of instruments, and scenes behind them.

``python -m masknet.draw OUT --seed 1 --tools 400 --scenes 300 --instruments lnd A.urdf B.urdf`` writes a shard:
``OUT/tools_1.npy`` (N, 384, 384, 6) uint8, `TOOL_CHANNELS`, ``OUT/tips_1.npy`` (N, 2), px, and ``OUT/scenes_1.npy``
(M, 384, 384, 3) uint8, BGR. Nothing in them is of a real instrument's picture.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import load_instrument
from dvrk_cmaes.geometry import frame_along, rotation_about_z, transform
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.synth.scene import Scene
from dvrk_cmaes.synth.truth import Truth

Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Random = np.random.Generator

SIZE: Final = 384  # px, sides of a layer
PICTURE: Final = 320  # px, width of a picture, in which focal lengths are meant
TOOL_CHANNELS: Final = "normal x", "normal y", "part", "along", "around", "depth"
"""Normal before the ray, -127 to 127, plus 128; 0 beside the tool, 1 shaft, 2 and more its other parts; mm along the
shaft modulo 256; angle about the shaft, 256 to a turn; 64 times the binary logarithm of depth over that of the tip,
plus 128."""
_WIDTHS: Final = 7.0, 120.0  # px, of a shaft in a picture
_LEAST: Final = 0.01  # of a layer, that is instrument


def draw_tool(instrument: Instrument, r: Random) -> tuple[Image, NDArray[np.float32]]:
    """Return a layer (SIZE, SIZE, 6) of an instrument that enters from a border, and its tip, px."""
    assert instrument.shaft is not None
    radius, middle = instrument.shaft.radius, SIZE / 2
    while True:
        focal, z = PICTURE * r.uniform(0.7, 2.4), np.exp(r.uniform(np.log(0.045), np.log(0.35)))
        if _WIDTHS[0] < 2 * radius * focal / z < _WIDTHS[1]:
            break
    tip = middle + r.uniform(-0.42, 0.42, 2) * [PICTURE, 0.8 * PICTURE]
    heading, tilt = r.uniform(0, 2 * np.pi), r.uniform(-0.3, 1.1)
    along = np.array([np.cos(tilt) * np.cos(heading), np.cos(tilt) * np.sin(heading), np.sin(tilt)])
    low, high = instrument.limits.T
    joints = np.clip(r.normal(0, 0.6, len(low)), low, high)
    for k, name in enumerate(instrument.joint_names):
        if name == "jaw":
            joints[k] = max(low[k], 0) if r.random() < 0.3 else r.uniform(max(low[k], 0), high[k])
    place = z * np.array([*(tip - middle) / focal, 1.0])
    pose = transform(frame_along(along) @ rotation_about_z(r.uniform(-np.pi, np.pi)), place)
    scene = Scene([Truth(instrument, pose, dict(zip(instrument.joint_names, joints.tolist(), strict=True)))])
    v, u = (np.mgrid[:SIZE, :SIZE].reshape(2, -1) - middle) / focal
    rays = np.stack([u, v, np.ones_like(u)], axis=1).astype(np.float32)
    face, depth = scene.hits(rays)
    hit = np.flatnonzero(face >= 0)
    layer = np.zeros((SIZE * SIZE, 6), np.uint8)
    if len(hit):
        own, towards = face[hit], rays[hit] / np.linalg.norm(rays[hit], axis=1, keepdims=True)
        local = (rays[hit] * depth[hit, None] - pose[:3, 3]) @ pose[:3, :3]
        link = scene.link[own]
        shaft = (link == 0) & (local[:, 2] < instrument.shaft.distal_end)
        normal = scene.normals(own)
        radial = np.where([True, True, False], local, 0.0)
        radial /= np.maximum(np.linalg.norm(radial, axis=1, keepdims=True), 1e-9)
        normal = np.where(shaft[:, None], radial @ pose[:3, :3].T, normal)
        normal[(normal * towards).sum(axis=1) > 0] *= -1
        # sideways in the image and at right angles to the ray
        right = np.cross([0.0, 1.0, 0.0], towards)
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        down = np.cross(towards, right)
        image = np.zeros((SIZE * SIZE, 3), np.float32)
        image[hit] = np.stack([(normal * right).sum(axis=1), (normal * down).sum(axis=1), np.ones(len(hit))], axis=1)
        smooth = cv2.GaussianBlur(image.reshape(SIZE, SIZE, 3), (0, 0), 0.8).reshape(-1, 3)[hit]
        layer[hit, :2] = np.clip(128 + 127 * smooth[:, :2] / smooth[:, 2:], 1, 255)
        layer[hit, 2] = np.where(shaft, 1, 2 + link)
        layer[hit, 3] = np.mod(1e3 * local[:, 2], 256).astype(np.uint8)
        layer[hit, 4] = (np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) * 256 + 128).astype(int) % 256
        layer[hit, 5] = np.clip(128 + 64 * np.log2(depth[hit] / z), 0, 255)
    return layer.reshape(SIZE, SIZE, 6), tip.astype(np.float32)


def _shown(instrument: Instrument, r: Random) -> tuple[Image, NDArray[np.float32]]:
    """Return the first drawn layer of an instrument that shows enough of it."""
    while True:
        drawn = draw_tool(instrument, r)
        if (drawn[0][..., 2] > 0).mean() > _LEAST:
            return drawn


def noise(r: Random, cells: float, octaves: int = 3) -> Float32:
    """Return smooth noise (SIZE, SIZE), 0 to 1, with some cells along a side at first."""
    total, weight = np.zeros((SIZE, SIZE), np.float32), 1.0
    for k in range(octaves):
        count = max(2, int(cells * 2**k))
        field = r.standard_normal((count, count)).astype(np.float32)
        total += weight * cv2.resize(field, (SIZE, SIZE), interpolation=cv2.INTER_CUBIC)
        weight *= r.uniform(0.35, 0.65)
    total -= total.min()
    return np.asarray(total / (total.max() + 1e-6))


def _colour(r: Random) -> Float32:
    """Return a colour (3,), BGR, 0 to 1: of tissue, grey, or any."""
    kind = r.random()
    if kind < 0.5:
        return np.array([r.uniform(0.05, 0.6), r.uniform(0.1, 0.6), r.uniform(0.35, 0.95)], np.float32)
    if kind < 0.75:
        return np.asarray(r.uniform(0.03, 0.97) * r.uniform(0.9, 1.1, 3), np.float32)
    return r.uniform(0, 1, 3).astype(np.float32)


def _relief(r: Random, strength: float, cells: float, octaves: int) -> Float32:
    """Return the brightness (SIZE, SIZE, 1) of an uneven surface."""
    height = noise(r, cells, octaves)
    slope = np.stack([cv2.Sobel(height, cv2.CV_32F, *of, ksize=5) for of in ((1, 0), (0, 1))], axis=-1)
    light = r.uniform(-0.6, 0.6, 2).astype(np.float32)
    lit = (1 - strength * slope @ light) / np.sqrt(1 + (strength**2) * (slope**2).sum(axis=-1))
    return np.asarray(np.clip(lit, 0.05, 2)[..., None], np.float32)


def _mixed(r: Random, first: Any, second: Any) -> Float32:
    """Return two colours or images mixed in patches with borders between sharp and soft."""
    share = np.clip((noise(r, r.uniform(1, 8)) - r.uniform(0.35, 0.65)) * r.uniform(3, 40) + 0.5, 0, 1)[..., None]
    return np.asarray(first * (1 - share) + second * share, np.float32)


def _shine(r: Random, image: Float32, most: float = 1.0) -> Float32:
    """Add moist highlights."""
    spots = np.clip((noise(r, r.uniform(12, 60), 2) - r.uniform(0.7, 0.9)) * r.uniform(5, 20), 0, 1)
    return np.asarray(image + spots[..., None] * r.uniform(0.3, most), np.float32)


def _walk(r: Random, steps: int, size: float) -> NDArray[np.int32]:
    """Return the points of a smooth random curve."""
    turns = r.normal(0, size, 2) + r.normal(0, 0.6 * size, (steps, 2))
    return np.cumsum(np.vstack([r.uniform(0, SIZE, (1, 2)), turns]), axis=0).astype(np.int32)


def _tissue(r: Random) -> Float32:
    base = _colour(r)
    image = _mixed(r, base, np.clip(base * r.uniform(0.4, 1.6, 3) + r.uniform(-0.15, 0.15, 3), 0, 1))
    if r.random() < 0.5:
        image = _mixed(r, image, np.clip(base * r.uniform(0.5, 1.5, 3), 0, 1))
    image *= 1 + r.uniform(0, 0.5) * (noise(r, r.uniform(8, 60), 2)[..., None] - 0.5)
    for _ in range(int(r.integers(0, 15))):
        colour = (base * r.uniform(0.3, 1.1, 3)).tolist()
        cv2.polylines(image, [_walk(r, int(r.integers(4, 18)), 14)], False, colour, int(r.integers(1, 4)), cv2.LINE_AA)
    image *= _relief(r, r.uniform(0, 3), r.uniform(1, 8), int(r.integers(2, 6)))
    return _shine(r, image) if r.random() < 0.6 else image


def _cloth(r: Random) -> Float32:
    v, u = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    image = np.tile(_colour(r), (SIZE, SIZE, 1))
    for angle in r.uniform(0, np.pi) + np.array([0, np.pi / 2]):
        wave = np.sin((u * np.cos(angle) + v * np.sin(angle)) * r.uniform(0.4, 2.5) + 4 * noise(r, 3))
        image *= 1 + r.uniform(0, 0.25) * wave[..., None]
    return image * _relief(r, r.uniform(0, 3), r.uniform(1, 5), 2) * (0.7 + 0.6 * noise(r, 40, 2)[..., None])


def _polygon(r: Random, size: float) -> NDArray[np.int32]:
    """Return a quadrilateral as a rectangle is seen, in sixteenths of a pixel."""
    angle, (a, b) = r.uniform(0, 2 * np.pi), r.uniform(0.15, 1, 2) * size
    corners = np.array([[-a, -b], [a, -b], [a, b], [-a, b]]) * r.uniform(0.8, 1.2, (4, 1))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray(16 * (corners @ turn.T + r.uniform(0, SIZE, 2)), np.int32)


def _filled(r: Random, image: Float32, corners: NDArray[np.int32], inside: Any) -> Float32:
    """Return an image with another one or a colour in a quadrilateral, with a shadow, at times with an edge."""
    mask = np.zeros((SIZE, SIZE), np.float32)
    cv2.fillConvexPoly(mask, corners, 1.0, cv2.LINE_AA, 4)
    shadow = cv2.GaussianBlur(np.roll(mask, tuple(r.integers(-8, 9, 2)), (0, 1)), (0, 0), r.uniform(1, 8))
    image = image * (1 - r.uniform(0, 0.7) * shadow[..., None])
    image = image * (1 - mask[..., None]) + mask[..., None] * inside
    if r.random() < 0.3:
        colour = r.uniform(0, 1, 3).tolist()
        cv2.polylines(image, [corners], True, colour, int(r.integers(1, 5)), cv2.LINE_AA, 4)
    return np.asarray(image, np.float32)


def _ramp(r: Random) -> Float32:
    """Return a linear change of brightness (SIZE, SIZE, 1)."""
    v, u = np.mgrid[-1 : 1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
    return np.asarray((1 + r.uniform(-0.4, 0.4) * u + r.uniform(-0.4, 0.4) * v)[..., None], np.float32)


def _boxes(r: Random) -> Float32:
    image = np.tile(_colour(r), (SIZE, SIZE, 1)) * _ramp(r)
    for _ in range(int(r.integers(2, 12))):
        inside = _colour(r) * _ramp(r) * (1 + r.uniform(0, 0.3) * (noise(r, r.uniform(4, 90), 2)[..., None] - 0.5))
        image = _filled(r, image, _polygon(r, r.uniform(20, 240)), inside)
    for _ in range(int(r.integers(0, 6))):
        centre = tuple(int(x) for x in r.uniform(0, SIZE, 2))
        width = int(r.integers(-1, 4)) or -1
        cv2.circle(image, centre, int(r.integers(3, 30)), _colour(r).tolist(), width, cv2.LINE_AA)
    return image


def _board(r: Random) -> Float32:
    """Draw printed boards: bright or coloured plates with margins, rows of holes and conductors."""
    image = _tissue(r) if r.random() < 0.3 else _boxes(r) if r.random() < 0.4 else np.tile(_colour(r), (SIZE, SIZE, 1))
    for _ in range(int(r.integers(1, 4))):
        plate = np.tile(np.clip(_colour(r) * r.uniform(0.7, 1.6), 0, 1), (SIZE, SIZE, 1)) * _ramp(r)
        step, size = float(r.uniform(5, 40)), float(r.uniform(0.8, 6))
        hole, angle = r.uniform(0, 1, 3).tolist(), float(r.uniform(0, np.pi))
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        cells = np.arange(-SIZE, SIZE, step) if r.random() < 0.75 else np.empty(0)
        ring = r.random() < 0.4
        for x in cells:
            for y in cells:
                place = SIZE / 2 + turn @ [x, y]
                if (place > -9).all() and (place < SIZE + 9).all():
                    at = tuple(int(k) for k in 16 * place)
                    cv2.circle(plate, at, int(16 * size), hole, 1 if ring else -1, cv2.LINE_AA, 4)
        for _ in range(int(r.integers(0, 14))):
            colour = r.uniform(0, 1, 3).tolist()
            start, way = r.uniform(0, SIZE, 2), angle + r.integers(0, 4) * np.pi / 2
            end = start + r.uniform(10, 300) * np.array([np.cos(way), np.sin(way)])
            ends = [tuple(int(k) for k in point) for point in (start, end)]
            cv2.line(plate, ends[0], ends[1], colour, int(r.integers(1, 7)), cv2.LINE_AA)
        corners = _polygon(r, r.uniform(80, 420))
        image = _filled(r, image, corners, plate)
        if r.random() < 0.6:  # its margin
            cv2.polylines(image, [corners], True, r.uniform(0.5, 1, 3).tolist(), int(r.integers(2, 16)), cv2.LINE_AA, 4)
    return image


def _organ(r: Random) -> Float32:
    """Draw rounded bodies before darkness."""
    image = np.full((SIZE, SIZE, 3), r.uniform(0, 0.1), np.float32)
    v, u = np.mgrid[-1 : 1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
    for _ in range(int(r.integers(1, 4))):
        (a, b), (x, y), angle = r.uniform(0.3, 1.1, 2), r.uniform(-0.7, 0.7, 2), r.uniform(0, np.pi)
        s, t = (u - x) * np.cos(angle) + (v - y) * np.sin(angle), (v - y) * np.cos(angle) - (u - x) * np.sin(angle)
        inside = 1 - (s / a) ** 2 - (t / b) ** 2 + r.uniform(0, 0.3) * (noise(r, 3) - 0.5)
        shade = np.clip(inside, 0, 1) ** r.uniform(0.3, 1)
        body = _colour(r) * (0.6 + 0.8 * noise(r, r.uniform(4, 40))[..., None]) * shade[..., None].astype(np.float32)
        body = _shine(r, body) if r.random() < 0.7 else body
        edge = np.clip(inside * r.uniform(10, 60), 0, 1)[..., None]
        image = np.asarray(image * (1 - edge) + body * edge, np.float32)
    return image


def _printed(r: Random) -> Float32:
    """Draw paper with text, or a chessboard or rows of dots."""
    image = np.tile(np.clip(_colour(r) * 1.3, 0, 1), (SIZE, SIZE, 1)) * _ramp(r) * (0.9 + 0.2 * noise(r, 2)[..., None])
    kind = r.random()
    if kind < 0.4:
        ink = np.zeros((SIZE, SIZE), np.uint8)
        for line in np.arange(r.uniform(0, 20), SIZE, r.uniform(10, 45)):
            text = "".join(r.choice(list("abcdefghklmnopqrstuv 0123456789.,"), 40))
            cv2.putText(ink, text, (int(r.uniform(-40, 40)), int(line)), 0, r.uniform(0.3, 1), 255, 1, cv2.LINE_AA)
        share = (ink / 255).astype(np.float32)[..., None]
        image = image * (1 - share) + share * r.uniform(0, 0.5, 3).astype(np.float32)
    elif kind < 0.7:
        cells = int(r.integers(4, 24))
        squares = (np.indices((cells, cells)).sum(axis=0) % 2).astype(np.float32)
        pattern = cv2.resize(squares, (SIZE, SIZE), interpolation=cv2.INTER_NEAREST)[..., None]
        image = _filled(r, image, _polygon(r, r.uniform(30, 300)), _colour(r) * (1 - pattern) + _colour(r) * pattern)
    return image


def _photograph(r: Random, photographs: Sequence[Image]) -> Float32:
    photo = photographs[int(r.integers(len(photographs)))]
    side = int(min(photo.shape[:2]) * r.uniform(0.3, 1))
    y, x = (r.integers(0, length - side + 1) for length in photo.shape[:2])
    image = cv2.resize(photo[y : y + side, x : x + side], (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    return np.asarray(image / 255, np.float32)


def draw_scene(r: Random, photographs: Sequence[Image] = ()) -> Image:
    """Draw what is behind instruments, (SIZE, SIZE, 3) BGR."""
    kinds: list[tuple[float, Callable[[Random], Float32]]] = [
        (0.36, _tissue),
        (0.1, _cloth),
        (0.14, _board),
        (0.14, _boxes),
        (0.1, _organ),
        (0.06, _printed),
    ]
    if photographs:
        kinds.append((0.1, lambda own: _photograph(own, photographs)))
    weights = np.array([weight for weight, _ in kinds])
    image = kinds[int(r.choice(len(kinds), p=weights / weights.sum()))][1](r)
    return np.asarray(np.clip(255 * image + 0.5, 0, 255), np.uint8)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw one shard of layers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--tools", type=int, default=400)
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--instruments", nargs="+", default=["lnd"])
    parser.add_argument("--meshes", type=Path, help="folder of the package dvrk_model that URDFs name")
    parser.add_argument("--photographs", nargs="*", type=Path, default=[])
    given = parser.parse_args(arguments)
    packages = {} if given.meshes is None else {"dvrk_model": given.meshes}
    instruments = [load_instrument(source, package_paths=packages) for source in given.instruments]
    read = [cv2.imread(str(path)) for path in given.photographs]
    photographs = [np.asarray(photo, np.uint8) for photo in read if photo is not None and min(photo.shape[:2]) > 120]
    given.out.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    scenes = [draw_scene(np.random.default_rng([given.seed, 0, k]), photographs) for k in range(given.scenes)]
    np.save(given.out / f"scenes_{given.seed}.npy", np.stack(scenes))
    random = [np.random.default_rng([given.seed, 1, k]) for k in range(given.tools)]
    tools = [_shown(instruments[r.integers(len(instruments))], r) for r in random]
    np.save(given.out / f"tips_{given.seed}.npy", np.stack([tip for _, tip in tools]))
    np.save(given.out / f"tools_{given.seed}.npy", np.stack([layer for layer, _ in tools]))


if __name__ == "__main__":
    main()
