"""What a session's frames show about its rig: how each further view differs from the file.

A frame states by which rotation each further view would fit the first one better. The errors of the masks differ from
frame to frame, while a wrong calibration turns the view in all of them alike. At one distance a wrong baseline
looks like a rotation about the axis across it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import CLEAR, NAMED, FoundBlock
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.results.result import Result

FEWEST = 3
"""Least number of frames in which a view is compared."""

LEAST_STD = np.array([0.01, 0.03, 0.01])
"""Least standard deviations, deg: a session's masks share errors that the scatter of its frames does not show.

About y the eyes see an instrument at 5 mm / 150 mm = 2 deg apart, which errors of its distance change in proportion:
1 % of the focal length and half a pixel of the shaft's width are 1.5 % of the distance.
"""

_RIG: Final = "rig "  # begins the name of the block of a view
_LEAST_ANGLE = 0.04  # deg, beyond which a view is turned, if it clearly is
_PASSES = 20  # of the weights
_TAIL = 9.0  # squared distance, in units of the common one, at which a frame has half of its weight
_MEDIAN_SQUARE = 2.366  # median of the squared distance of three unknowns


def rotations_of_session(results: Iterable[Result]) -> dict[str, FoundBlock]:
    """State the rotation of each further view, rad, by the results of a session's frames, each found by itself.

    The block is applied where the rotation is clear of zero. Views that are compared in fewer than three frames are
    left out.
    """
    return {f"{_RIG}{found[0]}": _stated(*found) for found in rotations_of_views(results)}


def _stated(view: str, count: int, rotation_deg: Float64, own_deg2: Float64) -> FoundBlock:
    """State the rotation of a view that was compared in a number of frames."""
    covariance = own_deg2 + np.diag(LEAST_STD**2)
    turned, std = is_turned(rotation_deg, covariance), np.sqrt(np.diag(covariance))
    clear = np.abs(rotation_deg) > NAMED * std
    clear[np.argmax(np.abs(rotation_deg) / std)] = True
    parts = [
        f"{value:.2f} +- {max(spread, 0.005):.2f} deg about {axis}"
        for axis, value, spread, named in zip("xyz", rotation_deg, std, clear, strict=True)
        if named
    ]
    than, against = ("rotated by", " against the file") if turned else ("as in the file:", "")
    text = f"the {view} eye is {than} {', '.join(parts)}{against}, in {count} frames"
    each = np.deg2rad(rotation_deg), np.deg2rad(std), np.full(3, np.pi)
    return FoundBlock.of("xyz", each, text, applied=turned)


def rotations_of_views(results: Iterable[Result]) -> Iterator[tuple[str, int, Float64, Float64]]:
    """Yield name, number of frames, rotation (3,), degrees, and its covariance of each view in three frames or more."""
    rotations_of: dict[str, list[tuple[Float64, Float64]]] = {}
    for result in results:
        for check in result.view_fits[1:]:
            pair = np.asarray(check.rotation_deg), np.asarray(check.covariance_deg2)
            rotations_of.setdefault(check.name, []).append(pair)
    for name, rotations in rotations_of.items():
        if len(rotations) >= FEWEST:
            yield name, len(rotations), *pooled_rotation(rotations)


def is_turned(rotation_deg: Float64, covariance_deg2: Float64) -> bool:
    """Return whether a rotation (3,) with its covariance (3, 3) is clear of zero."""
    sigmas = float(np.sqrt(rotation_deg @ np.linalg.solve(covariance_deg2, rotation_deg)))
    return sigmas > CLEAR and float(np.linalg.norm(rotation_deg)) > _LEAST_ANGLE


def turns_of(blocks: Mapping[str, FoundBlock]) -> dict[str, Float64]:
    """Return the rotations (3,), rad, of the views that are not used as in the file, by name."""
    return {
        name.removeprefix(_RIG): np.array(found.values)
        for name, found in blocks.items()
        if name.startswith(_RIG) and found.applied
    }


def pooled_rotation(rotations: Sequence[tuple[Float64, Float64]]) -> tuple[Float64, Float64]:
    """Return the robust mean of rotations (3,) weighted by their covariances (3, 3), and its covariance.

    The covariance grows where the rotations scatter more than their own covariances say; single ones that are far off,
    as of a frame in a wrong mode, count less.
    """
    values = np.array([rotation for rotation, _ in rotations])
    weights = np.linalg.inv(np.array([covariance for _, covariance in rotations]))
    mean = np.median(values, axis=0)
    for _ in range(_PASSES):
        off = values - mean
        squares = np.einsum("ki,kij,kj->k", off, weights, off)
        common = max(1.0, float(np.median(squares)) / _MEDIAN_SQUARE)
        share = 1 / (1 + squares / (_TAIL * common))
        covariance = np.linalg.inv(np.einsum("k,kij->ij", share, weights))
        mean = covariance @ np.einsum("k,kij,kj->i", share, weights, values)
    scatter = float(share @ squares) / max(3 * (float(share.sum()) - 1), 1.0)
    return mean, covariance * max(1.0, scatter)
