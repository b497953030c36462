"""Table of worlds: what varies between laboratories, in few rows that hold each pair of values at least once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, lru_cache
from itertools import combinations, product
from pathlib import Path
from typing import Any, Final, Literal, cast

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.synth.levels import LevelName

Lens = Literal["none", "barrel", "rational"]
Border = Literal["none", "circle", "bars"]
Row = Mapping[str, Any]

LENSES: Final[Mapping[str, tuple[str, tuple[float, ...]]]] = {
    "none": ("plumb_bob", ()),
    "barrel": ("plumb_bob", (-0.4, 0.2, 0.0005, -0.0005, 0.0)),
    "rational": ("rational_polynomial", (0.1, 0.02, 0.0004, -0.0003, 0.0, 0.45, 0.05, 0.0)),
}
"""Model and coefficients of the distortion."""

VALUES: Final[Mapping[str, tuple[Any, ...]]] = {
    "size": (
        (160, 120),
        (640, 480),
        (720, 480),
        (720, 576),
        (740, 540),
        (960, 540),
        (1000, 800),
        (1264, 1008),
        (1280, 720),
        (1280, 1024),
        (1300, 1024),
        (1400, 986),
        (1920, 1080),
        (3840, 2160),
    ),
    "focal": (0.5, 0.8, 1.2, 1.6, 2.2, 3.0),
    "lens": tuple(LENSES),
    "distance": (0.05, 0.08, 0.12, 0.18, 0.25, 0.35),
    "side": ("left", "right"),
    "arm": ("classic", "si"),
    "images_hz": (5, 10, 25, 30, 60),
    "readings_hz": (5, 10, 50, 200, 1000),
    "colour": ("colour", "grey"),
    "border": ("none", "circle", "bars"),
    "tools": (1, 2),
    "level": ("easy", "hard"),
}
"""The values of each parameter but the instrument, see `World`."""

LEAST_SHAFT: Final = 12.0
"""Width of the shaft in the image, px, from which on a world is in the table."""
LEAST_VIEW: Final = 0.03
"""Width of what the image shows at the wrist's distance, m, from which on a world is in the table."""
SHAFT: Final = 0.008
"""Diameter of the shafts, m, for ``LEAST_SHAFT``."""
_OFFERED: Final = 8  # rows, of which that with most new pairs is taken


@dataclass(frozen=True)
class World:
    """A row of the table.

    number : place in the table. size : of the image, px. focal : focal length in widths of the image. lens : a key of
    ``LENSES``. distance : of the wrist from the camera, m. instrument : ``lnd``, or the path of a URDF. side : from
    which the instrument comes into view. arm : kinematics. images_hz, readings_hz : rates of a recording. colour :
    ``colour`` or ``grey``. border : black ``circle`` about the image, which is stated in ignore/, or ``bars`` on either
    side, which are not. tools : number of instruments in view. level : of mistakes, ``easy`` or ``hard``.
    """

    number: int
    size: tuple[int, int]
    focal: float
    lens: Lens
    distance: float
    instrument: str
    side: Literal["left", "right"]
    arm: Arm
    images_hz: float
    readings_hz: float
    colour: Literal["colour", "grey"]
    border: Border
    tools: int
    level: LevelName

    @property
    def camera(self) -> Camera:
        """The camera, whose principal point is near the middle."""
        return _camera(self.size, self.focal, self.lens)

    @property
    def shaft_px(self) -> float:
        """Width of the shaft at the wrist's distance, px."""
        return SHAFT * self.focal * self.size[0] / self.distance

    def describe(self) -> dict[str, Any]:
        """Return the parameters as plain values for JSON and for rows of a report."""
        name = Path(self.instrument).stem.removeprefix("instrument_")
        return asdict(self) | {"size": "{} x {}".format(*self.size), "instrument": name}


@lru_cache(maxsize=4)
def _camera(size: tuple[int, int], widths: float, lens: Lens) -> Camera:
    """Return a camera with a focal length in widths of the image."""
    (width, height), (model, distortion) = size, LENSES[lens]
    return Camera(width, height, widths * width, widths * width, 0.51 * width, 0.49 * height, distortion, model)


def worlds() -> list[World]:
    """Return the table, of the bundled instrument."""
    values = {**VALUES, "instrument": ("lnd",)}
    return [World(number, **cast("Any", row)) for number, row in enumerate(covering_array(values))]


def covering_array(values: Mapping[str, Sequence[Any]], seed: int = 0) -> list[Row]:
    """Return rows with a value of each parameter, in which each pair of values is that can be seen (`can_be_seen`).

    A row begins with a pair that is in none yet, and takes for each other parameter the value with most new pairs; of
    several such rows the one with most is taken. Values and seed determine the rows, which are shuffled, so that the
    first ones are of every kind.
    """
    rng = np.random.default_rng(seed)
    left = {pair: None for pair in _all_pairs(values) if can_be_seen(dict(pair))}  # in order, unlike a set
    rows = []
    while left:
        offered = [_grown(dict(next(iter(left))), values, left, rng) for _ in range(_OFFERED)]
        best = max(offered, key=lambda row: sum(pair in left for pair in _pairs(row, values)))
        for pair in _pairs(best, values):
            left.pop(pair, None)
        rows.append({name: best[name] for name in values})
    return [rows[k] for k in rng.permutation(len(rows))]


def can_be_seen(row: Row) -> bool:
    """Whether a row, or some completion of one with part of the parameters, shows the instrument large enough, whole.

    That hangs on the image's size, the focal length and the distance alone.
    """
    return _can_be_seen(row.get("size"), row.get("focal"), row.get("distance"))


@cache
def _can_be_seen(size: tuple[int, int] | None, focal: float | None, distance: float | None) -> bool:
    """Whether one of the sizes, focal lengths and distances that are left open can be seen."""
    sizes = VALUES["size"] if size is None else (size,)
    focals = VALUES["focal"] if focal is None else (focal,)
    distances = VALUES["distance"] if distance is None else (distance,)
    return any(
        z / f >= LEAST_VIEW and SHAFT * f * width / z >= LEAST_SHAFT
        for (width, _), f, z in product(sizes, focals, distances)
    )


def _grown(
    row: dict[str, Any], values: Mapping[str, Sequence[Any]], left: Mapping[Any, None], rng: np.random.Generator
) -> Row:
    """Complete a row: the other parameters in random order, each with the value that makes most new pairs."""
    for name in rng.permutation([name for name in values if name not in row]).tolist():
        fits = [value for value in values[name] if can_be_seen({**row, name: value})]
        new = [sum(pair in left for pair in _pairs({**row, name: value}, values, name)) for value in fits]
        most = [value for value, count in zip(fits, new, strict=True) if count == max(new)]
        row[name] = most[rng.integers(len(most))]
    return row


def _pairs(row: Row, values: Mapping[str, Any], only: str | None = None) -> Iterator[tuple[Any, ...]]:
    """Yield the pairs of a row's values, each with its parameter, in the order of the parameters; or those of one."""
    for pair in combinations([(name, row[name]) for name in values if name in row], 2):
        if only is None or only in (pair[0][0], pair[1][0]):
            yield pair


def _all_pairs(values: Mapping[str, Sequence[Any]]) -> Iterator[tuple[Any, ...]]:
    """Yield all pairs of values of two parameters, each with its parameter."""
    for a, b in combinations(values, 2):
        yield from (((a, x), (b, y)) for x, y in product(values[a], values[b]))
