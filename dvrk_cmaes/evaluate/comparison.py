"""Comparison of sets of poses of the same frames: the difference of each frame, and their summary.

The reference is the truth if one of the sets is it, else the first set. Tips are compared where both sets state them or
have all joints of the instrument.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.compared_set import ComparedFrame, ComparedSet
from dvrk_cmaes.evaluate.pose_error import PoseError, pose_error, tips_in_camera
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.csv_file import Table, fixed
from dvrk_cmaes.io.encode import encoded, encoded_fields, rounded

QUANTITIES: Final = {"tip_mm": "tips, mm", "root_mm": "root, mm", "shaft_deg": "shaft, deg", "roll_deg": "roll, deg"}
"""Names of a difference's quantities but the joints, and their headings with units."""


@dataclass(frozen=True)
class Spread:
    """Median, 95th percentile and largest of the differences of N frames, and the frame of the largest."""

    median: float
    percentile_95: float
    largest: float
    frame: str

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Spread | None:
        """Summarise values by frame; None without any."""
        if not values:
            return None
        numbers = list(values.values())
        worst = max(values, key=lambda frame: values[frame])
        return cls(float(np.median(numbers)), float(np.percentile(numbers, 95)), values[worst], worst)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Sets of poses, their reference, and the differences from it.

    reference : index of the reference in ``sets``. frames : names of all frames, sorted.
    differences : for each set, by frame, where both it and the reference have a pose; empty for the reference.
    """

    sets: tuple[ComparedSet, ...]
    reference: int
    frames: tuple[str, ...]
    differences: tuple[Mapping[str, PoseError], ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Short names of the sets: A, B, and so on."""
        return tuple(chr(ord("A") + k) for k in range(len(self.sets)))

    @property
    def others(self) -> tuple[int, ...]:
        """Indices of the sets that are compared with the reference."""
        return tuple(k for k in range(len(self.sets)) if k != self.reference)

    @property
    def by_size(self) -> list[str]:
        """Frames with a difference, the largest of any set first."""
        sizes: dict[str, tuple[float, float]] = {}
        for differences in self.differences:
            for frame, difference in differences.items():
                sizes[frame] = max(difference.size, sizes.get(frame, difference.size))
        return sorted(sizes, key=lambda frame: (*(-value for value in sizes[frame]), frame))

    def spreads(self, index: int) -> dict[str, Spread | None]:
        """Summarise the differences of a set by quantity: those of ``QUANTITIES``, then each joint's without sign."""
        values: dict[str, dict[str, float]] = {name: {} for name in QUANTITIES}
        for frame, found in self.differences[index].items():
            own = {name: getattr(found, name) for name in QUANTITIES}
            own |= {f"{joint}_deg": abs(value) for joint, value in found.joints_deg.items()}
            for name, value in own.items():
                if value is not None:
                    values.setdefault(name, {})[frame] = value
        return {name: Spread.of(by_frame) for name, by_frame in values.items()}

    def within_90(self, index: int) -> tuple[int, int] | None:
        """Count the frames whose tips are all within their stated ``tip_90_mm`` of the truth, and those that state it.

        None if the reference is not the truth, or no frame states it.
        """
        known = [(d.farthest_tip_mm, frame.tip_90_mm) for d, frame in self._from_truth(index)]
        stated = [error <= limit for error, limit in known if error is not None and limit is not None]
        return (sum(stated), len(stated)) if stated else None

    def within_std(self, index: int) -> tuple[int, int, int] | None:
        """Count the frames whose tips' error is within its stated standard deviation, within twice of it, and all.

        None if the reference is not the truth, or no frame states it.
        """
        known = [(d.tip_mm, frame.tip_std_mm) for d, frame in self._from_truth(index)]
        ratios = np.array([error / std for error, std in known if error is not None and std])
        return (int((ratios <= 1).sum()), int((ratios <= 2).sum()), len(ratios)) if len(ratios) else None

    def _from_truth(self, index: int) -> Iterator[tuple[PoseError, ComparedFrame]]:
        """Yield the differences of a set with its frames; none if the reference is not the truth."""
        if self.sets[self.reference].kind == "truth":
            for name, difference in self.differences[index].items():
                yield difference, self.sets[index].frames[name]

    def sets_table(self) -> Table:
        """Return a row for each set: its label and path, what it is, numbers of frames by status, and overlap."""
        rows = []
        for label, compared in zip(self.labels, self.sets, strict=True):
            counts, overlap = count_statuses(compared), median_of(frame.iou for frame in compared.frames.values())
            failed = counts.get("failed", 0) + counts.get("lost", 0)
            by_status = (counts.get("ok", 0), counts.get("doubtful", 0), failed) if counts else ("-",) * 3
            cells = str(compared.path), compared.kind, len(compared.frames), *by_status, fixed(overlap, 4)
            rows.append((label, *map(str, cells)))
        return Table(("set", "results", "what", "frames", "ok", "doubtful", "failed", "IoU, median"), rows)

    def sums_table(self, index: int) -> Table:
        """Return a row for each quantity by which a set differs from the reference."""
        name = f"{self.labels[index]} from {self.labels[self.reference]}, {len(self.differences[index])} frames"
        rows = [
            (
                f"  {QUANTITIES.get(name, name.removesuffix('_deg') + ', deg')}",
                *(f"{value:.3f}" for value in (spread.median, spread.percentile_95, spread.largest)),
                spread.frame,
            )
            for name, spread in self.spreads(index).items()
            if spread is not None
        ]
        return Table((name, "median", "95 %", "largest", "in frame"), rows)

    def frames_table(self, frames: Sequence[str]) -> Table:
        """Return a row for each of some frames and each set that is compared there."""
        rows = []
        for frame in frames:
            for k in self.others:
                entry, found = self.sets[k].frames.get(frame), self.differences[k].get(frame)
                if entry is None or found is None:
                    continue
                status = f"{entry.status or '-'}{', twin' if found.is_twin else ''}"
                values = (found.tip_mm, found.root_mm, found.shaft_deg, found.roll_deg)
                cells = fixed(entry.iou, 4), *(fixed(value, 3) for value in values), fixed(found.joint_deg, 2)
                rows.append((frame, self.labels[k], status, *cells))
        head = "frame", "set", "status", "IoU", *QUANTITIES.values(), "largest joint, deg"
        return Table(head, rows)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: the sets with their summaries, and all differences by frame."""
        names = *QUANTITIES, "joints_deg"
        return {
            "reference": self.labels[self.reference],
            "sets": {label: self._summary(k) for k, label in enumerate(self.labels)},
            "frames": {
                frame: {
                    label: {
                        "status": compared.frames[frame].status,
                        "iou": compared.frames[frame].iou,
                        **(encoded_fields(differences[frame], *names) if frame in differences else {}),
                    }
                    for label, compared, differences in zip(self.labels, self.sets, self.differences, strict=True)
                    if frame in compared.frames
                }
                for frame in self.frames
            },
        }

    def _summary(self, index: int) -> dict[str, Any]:
        compared, differences = self.sets[index], self.differences[index]
        within, within_std = self.within_90(index), self.within_std(index)
        return {
            "path": str(compared.path),
            "kind": compared.kind,
            "statuses": count_statuses(compared),
            "iou_median": median_of(frame.iou for frame in compared.frames.values()),
            "seconds_median": median_of(frame.seconds for frame in compared.frames.values()),
            "compared": len(differences),
            "twins": sorted(frame for frame, difference in differences.items() if difference.is_twin),
            "tips_within_90": None if within is None else {"frames": within[0], "of": within[1]},
            "tips_within_std": None
            if within_std is None
            else dict(zip(("once", "twice", "of"), within_std, strict=True)),
            "differences": encoded(self.spreads(index)),
        }


def compare_sets(sets: Sequence[ComparedSet], instrument: Instrument) -> Comparison:
    """Compare two or more sets of poses of the same frames.

    Raises
    ------
    InputError
        More than one truth, or no frame that has a pose in the reference and in another set.
    """
    truths = [k for k, compared in enumerate(sets) if compared.kind == "truth"]
    if len(truths) > 1:
        raise InputError(f"{sets[truths[1]].path}: expected one truth, got {sets[truths[0]].path} too")
    reference = truths[0] if truths else 0
    base = sets[reference].frames
    sets = [compared.as_of(base) for compared in sets]
    differences = tuple(
        {}
        if k == reference
        else {
            name: difference
            for name, frame in sorted(compared.frames.items())
            if name in base and (difference := compare_frames(frame, base[name], instrument)) is not None
        }
        for k, compared in enumerate(sets)
    )
    if not any(differences):
        other = sets[1 if reference == 0 else 0]
        raise InputError(f"{other.path}: expected frames with a pose in {sets[reference].path} too, got none")
    names = tuple(sorted({name for compared in sets for name in compared.frames}))
    return Comparison(tuple(sets), reference, names, differences)


def compare_frames(frame: ComparedFrame, base: ComparedFrame, instrument: Instrument) -> PoseError | None:
    """Return the difference of a frame's pose from the reference's; None if one of them has no pose."""
    if frame.camera_from_root is None or base.camera_from_root is None:
        return None
    tips, expected = (
        tips_in_camera(instrument, one.camera_from_root, one.joints) if one.tips is None else one.tips
        for one in (frame, base)
        if one.camera_from_root is not None
    )
    return pose_error(frame.camera_from_root, base.camera_from_root, frame.joints, base.joints, tips, expected)


def count_statuses(compared: ComparedSet) -> dict[str, int]:
    """Count the frames of a set that have a status, by status: ok, doubtful, lost, failed."""
    statuses = [frame.status for frame in compared.frames.values()]
    return {status: statuses.count(status) for status in ("ok", "doubtful", "lost", "failed") if status in statuses}


def median_of(values: Iterator[float | None]) -> float | None:
    """Return the median of the known values; None without any."""
    known = [value for value in values if value is not None]
    return rounded(float(np.median(known))) if known else None
