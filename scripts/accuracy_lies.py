"""Frames in which something is false: an estimator that is honest doubts them.

Each kind of lie falsifies one thing about a frame with known truth: the mask, the camera or the readings. The last
three mostly hide, because another pose explains them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from accuracy_cases import HONEST, Case, Run
from accuracy_errors import reason_shares
from numpy.typing import NDArray

from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.synth.masks import SLIGHT, lump_of_tissue, segmented

Bool = NDArray[np.bool_]
Random = np.random.Generator

HIDING: Final = ("focal length off", "mirrored mask", "cropped and rescaled mask")
_FEWEST_PIXELS: Final = 500
_READING_OFF: Final = np.deg2rad(60.0)
_FOCAL_OFF: Final = 1.15
_CROPPED: Final = (0.65, 0.85)  # of the image's width


@dataclass(frozen=True)
class Sources:
    """What lies are made from: all honest cases, and other instruments by what they are called."""

    cases: Sequence[Case]
    others: Mapping[str, Body]


Lie = Callable[[Case, Sources, Random], Case | None]
"""Falsifies a case; None where that cannot be done to it."""


def other_instrument(name: str) -> Lie:
    """Another instrument in the same pose, taken for the one that is expected."""

    def lie(case: Case, sources: Sources, rng: Random) -> Case | None:
        assert case.truth is not None
        body = sources.others[name]
        joints = np.array([case.truth.joints[joint] for joint in body.instrument.joint_names])
        renderer = Renderer(body, case.camera, threads=1)
        mask = renderer.masks(case.truth.camera_from_root[None], joints[None])[0]
        if case.level != "clean" and mask.any():
            mask = segmented(mask, rng, SLIGHT).mask
        return replace(case, mask=mask)

    return lie


def something_else(case: Case, sources: Sources, rng: Random) -> Case:
    """Shapes that are no instrument: a lump, an ellipse, a polygon, a hand, a bar."""
    height, width = case.mask.shape
    centre = rng.uniform([0.2 * width, 0.2 * height], [0.8 * width, 0.8 * height])
    size = rng.uniform(0.1, 0.3) * height
    shape = rng.integers(5)
    if shape == 0:
        return replace(case, mask=lump_of_tissue((height, width), rng, centre, size))
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
    return replace(case, mask=image > 0)


def _draw_hand(image: NDArray[np.uint8], centre: NDArray[np.float64], size: float, turn: float, rng: Random) -> None:
    """Draw a palm with five fingers, and an arm that comes from the image's border."""
    at = centre.astype(int).tolist()
    cv2.circle(image, at, int(0.7 * size), 1, -1)
    for finger in turn + np.linspace(-0.9, 0.9, 5):
        end = centre + size * rng.uniform(1.3, 1.8) * np.array([np.cos(finger), np.sin(finger)])
        cv2.line(image, at, end.astype(int).tolist(), 1, max(int(0.28 * size), 3))
    wrist = centre - 2 * max(image.shape) * np.array([np.cos(turn), np.sin(turn)])
    cv2.line(image, at, wrist.astype(int).tolist(), 1, int(size))


def two_tools(case: Case, sources: Sources, rng: Random) -> Case | None:
    """Two tools in one mask: another frame's of the same camera and session is added."""
    others = [c for c in sources.cases if c.session == case.session and c.frame != case.frame]
    if not others:
        return None
    other = others[int(rng.integers(len(others)))]
    return replace(case, mask=case.mask | other.mask)


def half_mask(case: Case, sources: Sources, rng: Random) -> Case:
    """Cut the mask in half along a random line through its centroid."""
    v, u = np.nonzero(case.mask)
    turn = rng.uniform(0, 2 * np.pi)
    rows, columns = np.indices(case.mask.shape)
    side = (columns - u.mean()) * np.cos(turn) + (rows - v.mean()) * np.sin(turn)
    return replace(case, mask=case.mask & (side > 0))


def readings_off(case: Case, sources: Sources, rng: Random) -> Case:
    """Take readings of another frame: pitch or yaw is 60 degrees off."""
    name = ("wrist_pitch", "wrist_yaw")[rng.integers(2)]
    value = case.readings[name]
    off = -_READING_OFF if value > 0 else _READING_OFF  # towards the middle, so that it stays within the limits
    return replace(case, readings={**case.readings, name: value + off})


def focal_off(case: Case, sources: Sources, rng: Random) -> Case:
    """Focal length 15 % too long or too short."""
    factor = _FOCAL_OFF if rng.random() < 0.5 else 1 / _FOCAL_OFF
    return replace(case, camera=replace(case.camera, fx=case.camera.fx * factor, fy=case.camera.fy * factor))


def mirrored(case: Case, sources: Sources, rng: Random) -> Case:
    """Mirror the mask, left to right or top to bottom."""
    mask = case.mask[:, ::-1] if rng.random() < 0.5 else case.mask[::-1]
    return replace(case, mask=np.ascontiguousarray(mask))


def cropped(case: Case, sources: Sources, rng: Random) -> Case | None:
    """Crop the mask and enlarge it to the image's size, the camera left as it was."""
    height, width = case.mask.shape
    share = rng.uniform(*_CROPPED)
    h, w = round(share * height), round(share * width)
    top, left = rng.integers(height - h + 1), rng.integers(width - w + 1)
    part = case.mask[top : top + h, left : left + w].astype(np.float32)
    return replace(case, mask=cv2.resize(part, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5)


OTHER_INSTRUMENTS: Final = {"hook": "instrument_400183.urdf", "Maryland": "instrument_400172.urdf"}
LIES: Final[Mapping[str, Lie]] = {
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
    """Prepare the other instruments whose URDFs lie in a folder; none where it does not exist."""
    if not folder.is_dir():
        return {}
    return {name: Body.prepare(load_instrument(folder / file)) for name, file in OTHER_INSTRUMENTS.items()}


def make_lies(cases: Sequence[Case], others: Mapping[str, Body], count: int, seed: int) -> list[Case]:
    """Falsify cases, evenly spread, ``count`` of each kind; cycled through where there are fewer cases.

    A second round over the same frame makes another lie of it, whose frame is named after the round.
    """
    sources = Sources(cases, others)
    made = []
    for number, (kind, lie) in enumerate(LIES.items()):
        if kind.endswith(" for needle driver") and kind.split(" for ")[0] not in others:
            continue
        rng = np.random.default_rng([seed, number])
        kept: list[Case] = []
        order = [cases[i * len(cases) // count] for i in range(count)] if count < len(cases) else list(cases)
        for attempt in range(10 * count):
            case = order[attempt % len(order)] if attempt < len(order) else cases[int(rng.integers(len(cases)))]
            lied = lie(case, sources, rng)
            if lied is not None and _FEWEST_PIXELS < lied.mask.sum() < lied.mask.size // 2:
                kept.append(replace(lied, kind=kind, frame=f"{case.frame}_{attempt}"))
            if len(kept) == count:
                break
        made += kept
    return made


def lie_report(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """One row a kind and one a level of honest frames: the share doubted, and for what reasons."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        name = f"{HONEST}, {run.case.level}" if run.case.kind == HONEST else run.case.kind
        groups.setdefault(name, []).append(run)
    rows = []
    for name, group in groups.items():
        reasons = reason_shares(group)
        rows.append(
            {
                "kind": name + (" (hides)" if name in HIDING else ""),
                "cases": len(group),
                "doubted": sum(run.doubted for run in group) / len(group),
                "reasons": ", ".join(f"{reason} {share:.2f}" for reason, share in reasons.items()) or "-",
            }
        )
    return rows
