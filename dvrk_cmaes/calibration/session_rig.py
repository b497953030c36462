"""What a session's frames tell about its rig: how each further view differs from the file.

A frame states by which rotation each further view would fit the first one better. The errors of the masks differ from
frame to frame, while a wrong calibration turns the view in all of them alike. Baseline and focal length are told by all
frames together (see `rig_estimate`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.constants import CLEAR, NAMED
from dvrk_cmaes.camera.rig import ViewChange
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Count, Point, PositiveNumber
from dvrk_cmaes.results.result import Result

FEWEST = 3
"""Least number of frames in which a view is compared."""

LEAST_STD = np.array([0.01, 0.03, 0.01])
"""Least standard deviations, deg: a session's masks share errors that the scatter of its frames does not show.

About y the eyes see an instrument at 5 mm / 150 mm = 2 deg apart, which errors of its distance change in proportion:
1 % of the focal length and half a pixel of the shaft's width are 1.5 % of the distance.
"""

_LEAST_ANGLE = 0.04  # deg, beyond which a view is turned, if it clearly is
_PASSES = 20  # of the weights
_TAIL = 9.0  # squared distance, in units of the common one, at which a frame has half of its weight
_MEDIAN_SQUARE = 2.366  # median of the squared distance of three unknowns


@dataclass(frozen=True)
class ViewScale(Document):
    """A factor on a length of the rig's file, with its standard deviation; ``applied`` if the session used it."""

    scale: PositiveNumber
    std: PositiveNumber
    applied: bool

    @property
    def percent(self) -> tuple[float, float]:
        """The difference from the file and its standard deviation, %."""
        return 100 * (self.scale - 1), 100 * self.std

    @property
    def change(self) -> float:
        """The logarithm of the factor that was applied."""
        return float(np.log(self.scale)) if self.applied else 0.0

    def describe(self) -> str:
        """Describe the difference from the file in words."""
        percent, std = self.percent
        if not self.applied:
            return f"as in the file: {percent:+z.1f} % (std {std:.1f})"
        return f"{abs(percent):.1f} % (std {std:.1f}) {'longer' if percent > 0 else 'shorter'} than in the file"


@dataclass(frozen=True, eq=False)
class ViewRotation(Document):
    """Rotation of a further view of the rig against the file, about the first camera's axes, its baseline and lens.

    view : its name. rotation_deg, std_deg : (3,), degrees. frames : number of frames in which it was compared.
    applied : whether the session was solved with the view turned by it. baseline, focal_length : the factors on its
    distance from the first view and on its focal length relative to the first view's; None where they are not told.
    """

    view: str
    rotation_deg: Point
    std_deg: Point
    frames: Count
    applied: bool
    baseline: ViewScale | None = None
    focal_length: ViewScale | None = None

    @property
    def turn(self) -> Float64:
        """The rotation (3,) by which the view was turned, rad."""
        return np.deg2rad(self.rotation_deg) if self.applied else np.zeros(3)

    @property
    def change(self) -> ViewChange:
        """The change of the view with which the session was solved."""
        baseline, focal_length = (0.0 if each is None else each.change for each in (self.baseline, self.focal_length))
        return ViewChange(self.turn, baseline, focal_length)

    @property
    def differs(self) -> bool:
        """Whether the session was solved with a view that is not the file's."""
        return self.applied or any(each is not None and each.applied for each in (self.baseline, self.focal_length))

    def with_values(self, change: ViewChange, std: Float64) -> ViewRotation:
        """Return the view with other values of what is applied; ``std`` (2,) are those of baseline and focal length."""

        def other(scale: ViewScale | None, value: float, own: float) -> ViewScale | None:
            if scale is None or not scale.applied:
                return scale
            return replace(scale, scale=float(np.exp(value)), std=max(own, scale.std))

        return replace(
            self,
            rotation_deg=np.degrees(change.rotation) if self.applied else self.rotation_deg,
            baseline=other(self.baseline, change.baseline, float(std[0])),
            focal_length=other(self.focal_length, change.focal_length, float(std[1])),
        )

    def lines(self) -> list[tuple[str, bool]]:
        """Describe what is told of the view, one line each, and whether the frames contradict the file there."""
        out = [(self.describe(), self.applied)]
        parts = {"baseline": self.baseline, "focal length, relative to the first eye's,": self.focal_length}
        for name, scale in parts.items():
            if scale is not None:
                out.append((f"the {self.view} eye's {name} is {scale.describe()}", scale.applied))
        return out

    def warnings(self) -> list[str]:
        """Describe what of the rig's file the frames contradict, one line each."""
        return [text for text, contradicts in self.lines() if contradicts]

    def describe(self) -> str:
        """Describe the rotation in words: the components that are clear of zero, or the largest one."""
        clear = np.abs(self.rotation_deg) > NAMED * self.std_deg
        clear[np.argmax(np.abs(self.rotation_deg) / self.std_deg)] = True
        parts = [
            f"{value:.2f} +- {max(std, 0.005):.2f} deg about {axis}"
            for axis, value, std, named in zip("xyz", self.rotation_deg, self.std_deg, clear, strict=True)
            if named
        ]
        than = "rotated by" if self.applied else "as in the file:"
        return f"the {self.view} eye is {than} {', '.join(parts)}{' against the file' if self.applied else ''}"


def rotations_of_session(results: Iterable[Result]) -> tuple[ViewRotation, ...]:
    """Estimate the rotation of each further view from the results of a session's frames, each found by itself.

    A view is turned where its rotation is clear of zero. Views that are compared in fewer than three frames are left
    out.
    """
    found = []
    for name, count, rotation, own in rotations_of_views(results):
        covariance = own + np.diag(LEAST_STD**2)
        applied = is_turned(rotation, covariance)
        found.append(ViewRotation(name, rotation, np.sqrt(np.diag(covariance)), count, applied))
    return tuple(found)


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


def changes_of(rig: Sequence[ViewRotation]) -> Mapping[str, ViewChange]:
    """Return the changes of the views that are not used as in the file, by name."""
    return {each.view: each.change for each in rig if each.differs}


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
