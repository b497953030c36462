"""Falsified frames, whose results should be marked doubtful.

Each kind of falsification changes one input of a frame with known truth: the mask, the camera or the readings. The last
three kinds often remain unnoticed, because another pose explains the mask.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.synth.masks import SLIGHT, simulate_segmentation, tissue_region
from measure.accuracy.errors import reason_shares
from measure.cases import ORIGINAL, Case, Run, grouped

Bool = NDArray[np.bool_]
Random = np.random.Generator

OFTEN_UNNOTICED: Final = ("focal length off", "mirrored mask", "cropped and rescaled mask")
_FEWEST_PIXELS: Final = 500
_READING_OFF: Final = np.deg2rad(60.0)
_FOCAL_OFF: Final = 1.15
_CROPPED: Final = (0.65, 0.85)  # range of the cropped part, relative to the image's width


@dataclass(frozen=True)
class Sources:
    """Sources of falsifications: all original cases, and other instruments by name."""

    cases: Sequence[Case]
    others: Mapping[str, Body]


Falsification = Callable[[Case, Sources, Random], Case | None]
"""Function that returns a falsified copy of a case, or None if the case is not suitable."""


def other_instrument(name: str) -> Falsification:
    """Return the falsification that draws the mask of another instrument in the same pose."""

    def falsify(case: Case, sources: Sources, rng: Random) -> Case | None:
        body = sources.others[name]
        true = case.true(body.instrument)
        mask = Renderer(body, case.camera, threads=1).masks(true.pose[None], true.joints[None])[0]
        if case.level != "clean" and mask.any():
            mask = simulate_segmentation(mask, rng, SLIGHT).mask
        return case.with_mask(mask)

    return falsify


def something_else(case: Case, sources: Sources, rng: Random) -> Case:
    """Replace the mask by a shape that is not an instrument: a lump, an ellipse, a polygon, a hand or a bar."""
    height, width = case.mask.shape
    centre = rng.uniform([0.2 * width, 0.2 * height], [0.8 * width, 0.8 * height])
    size = rng.uniform(0.1, 0.3) * height
    shape = rng.integers(5)
    if shape == 0:
        return case.with_mask(tissue_region((height, width), rng, centre, size))
    image = np.zeros((height, width), dtype=np.uint8)
    at = centre.astype(int).tolist()
    turn = rng.uniform(0, 2 * np.pi)
    if shape == 1:
        axes = (int(size), int(size * rng.uniform(0.3, 0.9)))
        cv2.ellipse(image, at, axes, float(np.degrees(turn)), 0, 360, 1, -1)
    elif shape == 2:
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(4, 9)))
        reach = size * rng.uniform(0.6, 1.6, len(angles))
        corners = centre + reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        cv2.fillPoly(image, [corners.astype(np.int32)], 1)
    elif shape == 3:
        _draw_hand(image, centre, size, turn, rng)
    else:
        far = (centre + width * np.array([np.cos(turn), np.sin(turn)])).astype(int).tolist()
        cv2.line(image, at, far, 1, int(size * rng.uniform(0.4, 1.0)))
    return case.with_mask(image > 0)


def _draw_hand(image: NDArray[np.uint8], centre: NDArray[np.float64], size: float, turn: float, rng: Random) -> None:
    """Draw a palm with five fingers, and an arm that extends to the image's border."""
    at = centre.astype(int).tolist()
    cv2.circle(image, at, int(0.7 * size), 1, -1)
    for finger in turn + np.linspace(-0.9, 0.9, 5):
        end = centre + size * rng.uniform(1.3, 1.8) * np.array([np.cos(finger), np.sin(finger)])
        cv2.line(image, at, end.astype(int).tolist(), 1, max(int(0.28 * size), 3))
    wrist = centre - 2 * max(image.shape) * np.array([np.cos(turn), np.sin(turn)])
    cv2.line(image, at, wrist.astype(int).tolist(), 1, int(size))


def two_tools(case: Case, sources: Sources, rng: Random) -> Case | None:
    """Add the mask of another frame of the same session; None if the session has no other frame."""
    others = [c for c in sources.cases if c.recording is case.recording and c.frame != case.frame]
    if not others:
        return None
    other = others[int(rng.integers(len(others)))]
    return case.with_mask(case.mask | other.mask)


def half_mask(case: Case, sources: Sources, rng: Random) -> Case:
    """Cut the mask in half along a random line through its centroid."""
    v, u = np.nonzero(case.mask)
    turn = rng.uniform(0, 2 * np.pi)
    rows, columns = np.indices(case.mask.shape)
    side = (columns - u.mean()) * np.cos(turn) + (rows - v.mean()) * np.sin(turn)
    return case.with_mask(case.mask & (side > 0))


def readings_off(case: Case, sources: Sources, rng: Random) -> Case:
    """Change the reading of wrist pitch or wrist yaw by 60 degrees."""
    name = ("wrist_pitch", "wrist_yaw")[rng.integers(2)]
    value = case.readings[name]
    off = -_READING_OFF if value > 0 else _READING_OFF  # towards zero, to stay within the limits
    return replace(case, readings={**case.readings, name: value + off})


def focal_off(case: Case, sources: Sources, rng: Random) -> Case:
    """Make the focal length 15 % too long or too short."""
    factor = _FOCAL_OFF if rng.random() < 0.5 else 1 / _FOCAL_OFF
    return case.with_camera(replace(case.camera, fx=case.camera.fx * factor, fy=case.camera.fy * factor))


def mirrored(case: Case, sources: Sources, rng: Random) -> Case:
    """Mirror the mask, left to right or top to bottom."""
    mask = case.mask[:, ::-1] if rng.random() < 0.5 else case.mask[::-1]
    return case.with_mask(np.ascontiguousarray(mask))


def cropped(case: Case, sources: Sources, rng: Random) -> Case | None:
    """Crop the mask and enlarge it to the image's size, without a change of the camera."""
    height, width = case.mask.shape
    share = rng.uniform(*_CROPPED)
    h, w = round(share * height), round(share * width)
    top, left = rng.integers(height - h + 1), rng.integers(width - w + 1)
    part = case.mask[top : top + h, left : left + w].astype(np.float32)
    return case.with_mask(cv2.resize(part, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5)


OTHER_MAKE: Final = "instrument_400006.urdf"
"""Another make of the needle driver."""

OTHER_INSTRUMENTS: Final = {"hook": "instrument_400183.urdf", "Maryland": "instrument_400172.urdf"}
FALSIFICATIONS: Final[Mapping[str, Falsification]] = {
    **{f"{name} for needle driver": other_instrument(name) for name in OTHER_INSTRUMENTS},
    "something else": something_else,
    "two tools": two_tools,
    "half a mask": half_mask,
    "readings 60 deg off": readings_off,
    "focal length off": focal_off,
    "mirrored mask": mirrored,
    "cropped and rescaled mask": cropped,
}


def load_others(folder: Path) -> dict[str, Body]:
    """Prepare the other instruments whose URDFs are in a folder; empty if the folder does not exist."""
    if not folder.is_dir():
        return {}
    return {name: Body.prepare(load_instrument(folder / file)) for name, file in OTHER_INSTRUMENTS.items()}


def load_other_make(folder: Path) -> Body | None:
    """Prepare another make of the needle driver, whose URDF is in a folder; None if the folder does not exist."""
    return Body.prepare(load_instrument(folder / OTHER_MAKE)) if folder.is_dir() else None


def falsified_cases(cases: Sequence[Case], others: Mapping[str, Body], count: int, seed: int) -> list[Case]:
    """Return ``count`` falsified cases of each kind, made from evenly spaced cases.

    With fewer cases than ``count``, cases are used again with other random numbers. The names of falsified frames end
    in the number of the attempt.
    """
    sources = Sources(cases, others)
    made = []
    for number, (kind, falsify) in enumerate(FALSIFICATIONS.items()):
        if kind.endswith(" for needle driver") and kind.split(" for ")[0] not in others:
            continue
        rng = np.random.default_rng([seed, number])
        kept: list[Case] = []
        order = [cases[i * len(cases) // count] for i in range(count)] if count < len(cases) else list(cases)
        for attempt in range(10 * count):
            case = order[attempt % len(order)] if attempt < len(order) else cases[int(rng.integers(len(cases)))]
            changed = falsify(case, sources, rng)
            if changed is not None and _FEWEST_PIXELS < changed.mask.sum() < changed.mask.size // 2:
                kept.append(replace(changed, kind=kind, frame=f"{case.frame}_{attempt}"))
            if len(kept) == count:
                break
        made += kept
    return made


def doubt_report(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return the share of doubtful results and their reasons, by kind of falsification or level of original cases."""

    def kind_of(run: Run) -> str:
        return f"{ORIGINAL}, {run.case.level}" if run.case.kind == ORIGINAL else run.case.kind

    rows = []
    for name, group in grouped(runs, kind_of).items():
        reasons = reason_shares(group)
        rows.append(
            {
                "kind": name + (" (hides)" if name in OFTEN_UNNOTICED else ""),
                "cases": len(group),
                "doubted": sum(run.doubted for run in group) / len(group),
                "reasons": ", ".join(f"{reason} {share:.2f}" for reason, share in reasons.items()) or "-",
            }
        )
    return rows
