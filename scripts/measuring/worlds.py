"""Table of worlds: what varies between laboratories, in few rows that hold each pair of values; drawn by `synth`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import combinations, product
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.json_file import write_json
from dvrk_cmaes.synth.levels import LevelName
from measuring.runner import run

Kind = Literal["session", "recording"]
"""A session has postures of an arm, a recording consecutive frames."""
Pairs = dict[tuple[tuple[str, Any], tuple[str, Any]], None]

LENSES: Final[Mapping[str, tuple[str, tuple[float, ...]]]] = {
    "none": ("plumb_bob", ()),
    "barrel": ("plumb_bob", (-0.24, 0.1, 0.0005, -0.0005, 0.0)),
    "rational": ("rational_polynomial", (0.1, 0.02, 0.0004, -0.0003, 0.0, 0.3, 0.05, 0.0)),
}
"""Model and coefficients of the distortion."""
VALUES: Final[Mapping[str, tuple[Any, ...]]] = {
    "size": ((320, 240), (640, 480), (720, 480), (720, 576), (960, 540), (1280, 720), (1280, 1024), (1920, 1080)),
    "focal": (0.9, 1.2, 1.6, 2.2),
    "lens": (*LENSES,),
    "arm": ("classic", "si"),
    "tools": (1, 2),
    "level": ("easy", "medium", "hard"),
}
"""The values of each parameter, see `World`."""
_OFFERED: Final = 8  # rows, of which that with most new pairs is taken
_WORLD: Final = "world.json"


@dataclass(frozen=True)
class World:
    """A row of the table.

    number : place in the table. size : of the image, px. focal : focal length in widths of the image. lens : a key of
    ``LENSES``. arm : kinematics. tools : number of instruments in view. level : level of `synth`.
    """

    number: int
    size: tuple[int, int]
    focal: float
    lens: str
    arm: Arm
    tools: int
    level: LevelName

    @property
    def camera(self) -> Camera:
        """The camera, whose principal point is near the middle."""
        (width, height), (model, distortion) = self.size, LENSES[self.lens]
        return Camera(
            width, height, self.focal * width, self.focal * width, 0.51 * width, 0.49 * height, distortion, model
        )

    def describe(self) -> dict[str, Any]:
        """Return the parameters as plain values for rows of a report."""
        return asdict(self) | {"size": "{} x {}".format(*self.size)}


@dataclass(frozen=True)
class Drawn:
    """A drawn folder of a world with the truth of the instrument that is solved, that of the first arm."""

    path: Path
    world: World

    @property
    def arm(self) -> str | None:
        """Name of the arm that is solved; None of a single one."""
        return "PSM1" if self.world.tools > 1 else None

    def golden(self) -> dict[str, Any]:
        """Return the truth: ``camera_from_base`` and the frames by name."""
        name = "golden.json" if self.arm is None else f"golden_{self.arm}.json"
        found: dict[str, Any] = json.loads((self.path / name).read_text(encoding="utf-8"))
        return found


@cache
def worlds() -> dict[int, World]:
    """Return the table by number: each pair of values is in a row.

    A row begins with a pair that is in none yet, and takes for each other parameter the value with most new pairs; of
    several such rows the one with most is taken. The rows are shuffled, so that the first ones are of every kind.
    """
    rng = np.random.default_rng(0)
    left: Pairs = {((a, x), (b, y)): None for a, b in combinations(VALUES, 2) for x, y in product(VALUES[a], VALUES[b])}
    rows = []
    while left:
        offered = [_completed(dict(next(iter(left))), left, rng) for _ in range(_OFFERED)]
        best = max(offered, key=lambda row: sum(pair in left for pair in _pairs(row)))
        for pair in _pairs(best):
            left.pop(pair, None)
        rows.append(best)
    return {number: World(number=number, **rows[k]) for number, k in enumerate(rng.permutation(len(rows)))}


def _completed(row: dict[str, Any], left: Pairs, rng: np.random.Generator) -> dict[str, Any]:
    """Complete a row: the other parameters in random order, each with a value that makes most new pairs."""
    for name in rng.permutation([name for name in VALUES if name not in row]).tolist():
        new = [sum(pair in left for pair in _pairs({**row, name: value})) for value in VALUES[name]]
        most = [value for value, count in zip(VALUES[name], new, strict=True) if count == max(new)]
        row[name] = most[rng.integers(len(most))]
    return row


def _pairs(row: Mapping[str, Any]) -> Iterator[tuple[Any, Any]]:
    """Yield the pairs of a row's values, each with its parameter, in the order of the parameters."""
    yield from combinations([(name, row[name]) for name in VALUES if name in row], 2)


def drawn_world(parent: Path, world: World, seed: int, kind: Kind, frames: int, *, eyes: bool = False) -> Drawn:
    """Draw a session or a recording of a world into a folder of ``parent``, unless it is there already.

    Raises
    ------
    DvrkCmaesError
        No motion was found that keeps the instrument in view; a file cannot be written.
    """
    drawn = Drawn(parent / f"{kind}{'-eyes' if eyes else ''}-{frames}", world if not eyes else replace(world, tools=1))
    path, wanted = drawn.path / _WORLD, {"seed": seed, **world.describe()}
    if path.exists() and json.loads(path.read_text(encoding="utf-8")) == wanted:
        return drawn
    shutil.rmtree(drawn.path, ignore_errors=True)
    camera = parent / "camera.yaml"
    write_camera_info(camera, world.camera, "world")
    line = ["synth", str(drawn.path), "--camera", str(camera), "--level", world.level, "--arm", world.arm]
    line += ["--motion", "video" if kind == "recording" else "rcm", "--frames", str(frames), "--seed", str(seed)]
    line += ["--stereo"] if eyes else []
    line += ["--arms", "2", *([] if kind == "recording" else ["--no-images"])] if drawn.world.tools > 1 else []
    _, failure = run(line)
    if failure is not None:
        raise (InputError if failure.code == 2 else DvrkCmaesError)(f"world {world.number}: {failure.error}")
    write_json(path, wanted)
    return drawn
