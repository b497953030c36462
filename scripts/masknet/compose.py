"""Training pictures with exact masks, composed at random from drawn layers: shading, light, camera and disturbances.

Needs NumPy and OpenCV alone, so that it runs beside the library that trains.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Random = np.random.Generator

_VIEW: Final = 320, 256  # px of a layer that a picture shows, at scale 1
_TOOLS: Final = (0.07, 0.42, 0.37, 0.14)  # probabilities of none to three
_GRID: Final = 32  # cells of the normals along each side of a table of colours
_STEP: Final = 256 // _GRID


class Layers:
    """Layers of all shards in a folder, read as they are needed; new shards count from the next `refresh` on."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.refresh()

    def refresh(self) -> None:
        """Look for shards."""
        self._tools: list[NDArray[np.uint8]] = []
        self._tips: list[NDArray[np.float32]] = []
        self._scenes: list[NDArray[np.uint8]] = []
        for path in sorted(self._folder.glob("tools_*.npy")):  # the last of a shard's files
            shard = path.stem.removeprefix("tools_")
            try:
                files = [self._folder / f"{kind}_{shard}.npy" for kind in ("tools", "tips", "scenes")]
                own = [np.load(file, mmap_mode="r") for file in files]
            except (ValueError, OSError):  # still being written
                continue
            self._tools.append(own[0])
            self._tips.append(own[1])
            self._scenes.append(own[2])

    def __len__(self) -> int:
        return sum(map(len, self._tools))

    def tool(self, r: Random) -> tuple[Image, NDArray[np.float32]]:
        """Return an instrument's layer and its tip."""
        shard = int(r.integers(len(self._tools)))
        k = int(r.integers(len(self._tools[shard])))
        return self._tools[shard][k], self._tips[shard][k]

    def scene(self, r: Random, size: tuple[int, int]) -> Float32:
        """Return a part of a scene (h, w, 3), 0 to 1, of another colour, turned and mirrored."""
        shard = self._scenes[int(r.integers(len(self._scenes)))]
        whole = _turned(shard[int(r.integers(len(shard)))], int(r.integers(8)))
        scale = r.uniform(0.3, 1)
        height, width = int(scale * whole.shape[0] * 0.8), int(scale * whole.shape[1])
        y, x = r.integers(0, whole.shape[0] - height + 1), r.integers(0, whole.shape[1] - width + 1)
        part = np.ascontiguousarray(whole[y : y + height, x : x + width])
        image = cv2.resize(part, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        grey = image.mean(axis=2, keepdims=True)
        image = grey + (image - grey) * r.uniform(0, 1.1)
        if r.random() < 0.3:
            image = (image - image.mean()) * r.uniform(0.1, 0.8) + r.uniform(0, 1)
        return np.asarray(image * r.uniform(0.6, 1.5), np.float32)


def _turned(image: Image, way: int) -> Image:
    """Return an image turned by a multiple of 90 deg and mirrored, by one of eight ways."""
    turned = np.rot90(image, way % 4)
    return turned[:, ::-1] if way >= 4 else turned


def _noise(r: Random, size: tuple[int, int], cells: float) -> Float32:
    field = r.random((max(2, int(cells)), max(2, int(cells))), dtype=np.float32)
    return np.asarray(cv2.resize(field, size, interpolation=cv2.INTER_CUBIC))


def _colours(r: Random, albedo: Float32, *, shine: float, mirror: float) -> Float32:
    """Return colours (cells, 3) of a surface by its normal before the ray."""
    v, u = np.mgrid[-1 : 1 : _GRID * 1j, -1 : 1 : _GRID * 1j].astype(np.float32)
    w = np.sqrt(np.clip(1 - u * u - v * v, 0, 1))
    light = np.array([*r.normal(0, 0.3, 2), 1.0])
    light /= np.linalg.norm(light)
    facing = np.clip(u * light[0] + v * light[1] + w * light[2], 0, 1)
    diffuse = r.uniform(0.02, 0.4) + r.uniform(0.4, 1.1) * facing ** r.uniform(0.6, 2)
    around = np.clip(_noise(r, (_GRID, _GRID), r.uniform(2, 9)), 0, 1) ** r.uniform(0.7, 3)
    gloss = shine * facing ** r.uniform(6, 70)
    base = (diffuse * (1 - mirror) + mirror * 1.3 * around)[..., None] * albedo
    return np.asarray(base + gloss[..., None], np.float32).reshape(-1, 3)


def _seen_tool(layers: Layers, r: Random, size: tuple[int, int]) -> tuple[Image, int] | None:
    """Return the part of an instrument's layer that a picture shows, (h, w, 6), and the way that it was turned."""
    layer, tip = layers.tool(r)
    way = int(r.integers(8))
    scale = r.uniform(0.6, 1.2)
    window = np.array(_VIEW if way % 2 == 0 else _VIEW[::-1]) * scale
    width, height = (int(x) for x in window)
    place = r.uniform(0.05, 0.95, 2) if r.random() < 0.85 else r.uniform(-0.3, 1.3, 2)
    x, y = np.clip(tip - place * window, 0, np.array(layer.shape[1::-1]) - window).astype(int)
    part = layer[y : y + height, x : x + width]
    if np.count_nonzero(part[..., 2]) < 0.004 * width * height:
        return None
    return np.asarray(cv2.resize(np.ascontiguousarray(_turned(part, way)), size, interpolation=cv2.INTER_NEAREST)), way


def _shaded(part: Image, way: int, r: Random) -> Float32:
    """Return colour times coverage, and coverage, (h, w, 4)."""
    rows, columns = np.nonzero(part[..., 2])
    nx, ny, kind, along, around, depth = part[rows, columns].astype(np.int32).T
    nx, ny = nx - 128, ny - 128
    for _ in range(way % 4):
        nx, ny = ny, -nx
    nx = -nx if way >= 4 else nx
    cell = np.clip(ny + 128, 0, 255) // _STEP * _GRID + np.clip(nx + 128, 0, 255) // _STEP
    tint = 1 + r.normal(0, 0.05, 3).astype(np.float32)
    if r.random() < 0.6:  # a dark shaft
        shaft, mirror = r.uniform(0.01, 0.14) * tint, r.uniform(0, 0.5)
    elif r.random() < 0.8:
        shaft, mirror = r.uniform(0.1, 0.9) * tint, r.uniform(0, 0.8)
    else:
        shaft, mirror = r.uniform(0.1, 1, 3), r.uniform(0, 0.3)
    metal = r.uniform(0.25, 0.95) * (1 + r.normal(0, 0.05, 3))
    tables = np.stack(
        [
            _colours(r, np.asarray(shaft, np.float32), shine=r.uniform(0, 0.5), mirror=mirror),
            _colours(r, metal.astype(np.float32), shine=r.uniform(0.2, 1.5), mirror=r.uniform(0.1, 0.9)),
            _colours(r, metal.astype(np.float32), shine=r.uniform(0.2, 1.5), mirror=r.uniform(0.1, 0.9)),
        ]
    )
    of_part = r.uniform(0.5, 1.3, 16).astype(np.float32)
    colour = tables[np.where(kind == 1, 0, 1 + kind % 2), cell] * of_part[kind, None]
    if r.random() < 0.6:  # wear and dirt
        spots = _noise(r, (128, 128), r.uniform(8, 60))
        colour *= (1 + r.uniform(0.1, 0.7) * (spots[along // 2, around // 2] - 0.5))[:, None]
    if r.random() < 0.35:  # rings and print on the shaft
        bands = np.ones((256, 3), np.float32)
        for _ in range(int(r.integers(1, 8))):
            start = int(r.integers(0, 256))
            hue = r.uniform(0.5, 1, 3) if r.random() < 0.4 else np.ones(3)
            bands[start : start + int(r.integers(1, 14))] = r.uniform(0.3, 3) * hue
        colour *= np.where((kind == 1)[:, None], bands[along], np.float32(1))
    if r.random() < 0.3:
        wave = np.sin(np.arange(256) * r.uniform(1, 3))
        colour *= (1 + r.uniform(0, 0.4) * wave).astype(np.float32)[along, None]
    by_depth = np.exp2(-r.uniform(0, 1.6) * (np.arange(256) - 128) / 64).clip(0.15, 3).astype(np.float32)
    colour *= by_depth[depth, None]
    drawn = np.zeros((*part.shape[:2], 4), np.float32)
    drawn[rows, columns, :3] = np.clip(colour * r.uniform(0.6, 1.4), 0, 1.3)
    drawn[rows, columns, 3] = 1
    return drawn


def _things(image: Float32, r: Random, most: int) -> None:
    """Draw threads, needles, tubes and patches into an image."""
    height, width = image.shape[:2]
    size, unit = np.array([width, height]), width / 160
    for _ in range(int(r.integers(0, most + 1))):
        kind, colour = r.random(), _any_colour(r).tolist()
        thin = max(1, int(unit * r.uniform(0.4, 1.6)))
        if kind < 0.35:
            steps = np.vstack([r.uniform(0, 1, (1, 2)) * size, r.normal(0, 6 * unit, (int(r.integers(6, 25)), 2))])
            cv2.polylines(image, [np.cumsum(steps, axis=0).astype(np.int32)], False, colour, thin, cv2.LINE_AA)
        elif kind < 0.5:
            axes, centre = (int(unit * r.uniform(4, 18)),) * 2, (int(r.uniform(0, width)), int(r.uniform(0, height)))
            grey = [r.uniform(0.3, 1)] * 3
            cv2.ellipse(image, centre, axes, r.uniform(0, 360), 0, r.uniform(90, 220), grey, thin, cv2.LINE_AA)
        elif kind < 0.75:
            corners = r.uniform(0, 1, 2) * size + r.normal(0, 22 * unit, (int(r.integers(3, 7)), 2))
            cv2.fillConvexPoly(image, cv2.convexHull(corners.astype(np.int32)), colour, cv2.LINE_AA)
        else:
            ends = [tuple(int(x) for x in r.uniform(-0.2, 1.2, 2) * size) for _ in range(2)]
            bright = r.uniform(0.6, 1, 3) if r.random() < 0.5 else r.permutation(r.uniform([0, 0, 0.5], [0.25, 0.8, 1]))
            for share in np.linspace(1, 0.1, 6):
                wide = max(1, int(unit * share * r.uniform(2, 14)))
                cv2.line(image, ends[0], ends[1], (bright * (1.1 - 0.7 * share)).tolist(), wide, cv2.LINE_AA)


def _any_colour(r: Random) -> NDArray[np.float64]:
    """Return a colour (3,), 0 to 1, in half of the cases grey as instruments are."""
    return np.full(3, r.random() ** 1.5) if r.random() < 0.5 else r.uniform(0, 1, 3)


def _squares(image: Float32, r: Random) -> Float32:
    """Return an image with a plate of squares of two colours."""
    height, width = image.shape[:2]
    cells = r.integers(2, 16, 2)
    pattern = (np.indices(tuple(cells)).sum(axis=0) % 2).astype(np.float32)
    angle, size = r.uniform(0, 2 * np.pi), width * r.uniform(0.1, 1.3)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [cells[1] / cells.max(), cells[0] / cells.max()]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    seen = (corners * r.uniform(0.85, 1.15, (4, 1))) @ turn.T * size / 2 + r.uniform(0, 1, 2) * [width, height]
    scale = 8  # px of a cell, so that its edges are sharp
    large = cv2.resize(pattern, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    ends = np.array([[0, 0], [cells[1], 0], [cells[1], cells[0]], [0, cells[0]]]) * scale
    place = cv2.getPerspectiveTransform(ends.astype(np.float32), seen.astype(np.float32))
    both = cv2.merge([large, np.ones_like(large)])
    share = cv2.warpPerspective(both, place, (width, height), flags=cv2.INTER_LINEAR)
    squares = share[..., :1] * _any_colour(r) + np.maximum(share[..., 1:] - share[..., :1], 0) * _any_colour(r)
    squares = squares * (1 + r.uniform(0, 0.4) * (_noise(r, (width, height), r.uniform(2, 40))[..., None] - 0.5))
    return np.asarray(image * (1 - share[..., 1:]) + squares, np.float32)


def _patch(r: Random, size: tuple[int, int], spread: float) -> Float32:
    """Return a rounded region (h, w, 1), 0 to 1."""
    corners = r.uniform(0, 1, 2) * size + r.normal(0, spread * size[0], (6, 2))
    mask = np.zeros(size[::-1], np.float32)
    cv2.fillConvexPoly(mask, cv2.convexHull(corners.astype(np.int32)), 1.0)
    return np.asarray(cv2.GaussianBlur(mask, (0, 0), r.uniform(0.5, 2.5))[..., None], np.float32)


def _camera(image: NDArray[Any], mask: Float32, r: Random) -> Image:
    """Return an image (h, w, 3) as a camera records it; what its border hides is taken from the mask."""
    height, width = mask.shape
    v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    away = (u - np.float32(r.uniform(-0.5, 0.5))) ** 2 + (v - np.float32(r.uniform(-0.5, 0.5))) ** 2
    image = image * np.clip(1 - r.uniform(0, 0.5) * away, 0, 1)[..., None] * np.exp(r.uniform(-0.6, 0.8))
    if r.random() < 0.12:  # haze
        share = r.uniform(0, 0.5)
        image = image * (1 - share) + share * r.uniform(0.2, 1)
    if r.random() < 0.25:
        if r.random() < 0.5:
            inside = (u - r.uniform(-0.1, 0.1)) ** 2 + (0.8 * v - r.uniform(-0.1, 0.1)) ** 2 < r.uniform(0.8, 1.25) ** 2
        else:
            a, b, c, d = r.uniform(0, 0.2, 4) * (r.random(4) < 0.5)
            inside = (u > a - 1) & (u < 1 - b) & (v > c - 1) & (v < 1 - d)
        image = np.where(inside[..., None], image, r.uniform(0, 0.08))
        mask *= inside
    if r.random() < 0.5:
        image = image / (1 + r.uniform(0, 0.6) * image)
    image = np.clip(image, 0, 1).astype(np.float32)
    if r.random() < 0.7:
        image = cv2.GaussianBlur(image, (0, 0), width / 160 * r.uniform(0.25, 1.0))
    if r.random() < 0.12:
        length, angle = int(r.integers(3, 8)), r.uniform(0, np.pi)
        kernel = np.zeros((9, 9), np.float32)
        reach = length / 2 * np.array([np.cos(angle), np.sin(angle)])
        ends = [tuple(round(x) for x in (4 + sign * reach).tolist()) for sign in (1, -1)]
        cv2.line(kernel, ends[0], ends[1], 1.0)
        image = cv2.filter2D(image, -1, kernel / kernel.sum())
    if r.random() < 0.3:  # sharpened
        image = image + r.uniform(0, 1.2) * (image - cv2.GaussianBlur(image, (0, 0), 1.0))
    image = np.asarray(np.clip(image, 0, 1) ** r.uniform(0.55, 1.6), np.float32)
    kind = r.random()
    if kind < 0.25:
        image = np.repeat(image.mean(axis=2, keepdims=True), 3, axis=2)
    else:
        image = image * (1 + r.normal(0, 0.1, 3)).astype(np.float32) + r.normal(0, 0.03, 3).astype(np.float32)
    noise = r.standard_normal(image.shape, dtype=np.float32)
    image = image + noise * (r.uniform(0, 0.04) if r.random() < 0.8 else r.uniform(0.04, 0.1))
    recorded = np.asarray(np.clip(255 * image + 0.5, 0, 255), np.uint8)
    if r.random() < 0.4:
        coded = cv2.imencode(".jpg", recorded, [cv2.IMWRITE_JPEG_QUALITY, int(r.integers(30, 95))])[1]
        recorded = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
    return np.asarray(recorded)


def compose(layers: Layers, r: Random, size: tuple[int, int]) -> tuple[Image, Image]:
    """Return a picture (h, w, 3) uint8 BGR of a size (w, h), and its mask (h, w), 255 on instruments."""
    finer = (2 * size[0], 2 * size[1]) if size[0] < _VIEW[0] else size
    image, mask = layers.scene(r, size), np.zeros(size[::-1], np.float32)
    if r.random() < 0.3:
        share = np.clip((_noise(r, size, r.uniform(2, 5)) - 0.5) * r.uniform(3, 40) + 0.5, 0, 1)[..., None]
        image = image * (1 - share) + share * layers.scene(r, size)
    if r.random() < 0.12:
        image = _squares(image, r)
    _things(image, r, 3)
    for _ in range(int(r.choice(len(_TOOLS), p=_TOOLS))):
        seen = _seen_tool(layers, r, finer)
        if seen is None:
            continue
        drawn: NDArray[Any] = _shaded(*seen, r)
        if finer == size:
            drawn = cv2.GaussianBlur(drawn, (3, 3), 0.6)
        else:
            drawn = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
        alpha = drawn[..., 3:]
        if r.random() < 0.6:
            shift = (r.normal(0, 0.03, 2) * size[0]).astype(int)
            soft = size[0] * r.uniform(0.008, 0.05)
            shadow = cv2.GaussianBlur(np.roll(drawn[..., 3], tuple(shift), (0, 1)), (0, 0), soft)
            image = image * (1 - r.uniform(0, 0.8) * shadow[..., None])
        image = np.asarray(image * (1 - alpha) + drawn[..., :3], np.float32)
        mask = np.maximum(mask, drawn[..., 3])
    if r.random() < 0.3:
        _things(image, r, 1)
    if r.random() < 0.25:  # something before the tool
        share = _patch(r, size, r.uniform(0.04, 0.2))
        image = np.asarray(image * (1 - share) + share * layers.scene(r, size), np.float32)
        mask *= 1 - share[..., 0]
    return _camera(image, mask, r), np.asarray(255 * mask + 0.5, np.uint8)
