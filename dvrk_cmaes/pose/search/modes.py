"""Selection of modes: distinct local optima of the pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from dvrk_cmaes.geometry import Bool, Posed, rotation_angle
from dvrk_cmaes.instrument import Instrument


@dataclass(frozen=True, eq=False)
class PoseCandidate:
    """One pose with its joints, and its ``score``: a loss or negative log-likelihood, the lower the better."""

    at: Posed
    score: float


C = TypeVar("C", bound=PoseCandidate)


_ANGLE, _JOINT = float(np.deg2rad(15)), float(np.deg2rad(25))  # between poses of the same mode, at most


_TWIN_ANGLE = np.deg2rad(40)  # between a mode and the mirror twin of another that count as the same


def are_distinct(a: Posed, b: Posed) -> Bool:
    """Return whether poses differ by more than 15 degrees in rotation or more than 25 degrees in any joint, (...).

    ``a`` is one pose, ``b`` may be several.
    """
    turned = rotation_angle(a.pose, b.pose) > _ANGLE
    return np.asarray(turned | (np.abs(b.joints - a.joints).max(axis=-1, initial=0.0) > _JOINT))


def twin_of(instrument: Instrument, at: Posed) -> Posed:
    """Return the mirror twin of a pose."""
    return Posed(*instrument.twin(at.pose, at.joints))


def is_twin(instrument: Instrument, a: Posed, b: Posed) -> bool:
    """Return whether two poses are in modes that are mirror twins of each other."""
    return bool(rotation_angle(twin_of(instrument, a).pose, b.pose) < _TWIN_ANGLE)


def best_per_mode(candidates: Sequence[C], *, most: int | None = None, mirrored: Instrument | None = None) -> list[C]:
    """Select the best candidate of each mode, sorted by score, at most ``most``; modes are as in `first_of_modes`."""
    ordered = sorted(candidates, key=lambda candidate: candidate.score)
    at = Posed.stacked([candidate.at for candidate in ordered])
    return [ordered[k] for k in first_of_modes(at, most=most, mirrored=mirrored)]


def first_of_modes(
    at: Posed,
    *,
    angle: float = _ANGLE,
    joint: float = _JOINT,
    most: int | None = None,
    mirrored: Instrument | None = None,
) -> list[int]:
    """Return which of C poses are of none of the modes before them, at most ``most``.

    Poses are of the same mode if they are not distinct by the thresholds ``angle`` and ``joint``, rad. If the
    instrument is given as ``mirrored`` and has a mirror twin, poses and their twins are of the same mode.
    """
    kept, left = list[int](), np.arange(len(at))
    each = [at] if mirrored is None or not mirrored.has_twin else [at, twin_of(mirrored, at)]
    rotations = [one.pose[:, :3, :3].reshape(-1, 9) for one in each]
    while len(left) and len(kept) != most:
        kept.append(int(left[0]))
        for one, turned in zip(each, rotations, strict=True):
            traces = rotations[0][left] @ turned[kept[-1]]  # of the rotations between both
            far = traces < 1 + 2 * np.cos(angle)
            left = left[far | (np.abs(at.joints[left] - one.joints[kept[-1]]) > joint).any(axis=1)]
    return kept
