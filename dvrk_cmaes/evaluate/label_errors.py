"""Errors of poses in the image: distances of labelled points from where a pose and its joints put them, px.

Labels are a session's markers.csv, and a table states where on the instrument each of them lies (see
`frames.markers`). They need not be exact: errors include those of labels, table and camera.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.files import read_camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.compared_set import ComparedFrame, ComparedSet
from dvrk_cmaes.frames.markers import Marker, place_markers, read_detections, read_marker_table
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.geometry import Float64, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.csv_file import Table
from dvrk_cmaes.io.encode import rounded_values
from dvrk_cmaes.io.files import bundled_path
from dvrk_cmaes.io.short_text import listed, natural

_LABELS: Final = "markers.csv"
_TABLES: Final = ("lnd.json", "surgpose.json")


@dataclass(frozen=True, eq=False)
class Labels:
    """Labelled points of a session.

    path : of markers.csv. camera : of the images they are in. pixels : (2,) by frame and label, of those that the table
    has. table : of the points, by label, read from ``table_path``. left_out : labels that the table does not have.
    """

    path: Path
    camera: Camera
    pixels: Mapping[str, Mapping[str, Float64]]
    table: Mapping[str, Marker]
    table_path: Path
    left_out: tuple[str, ...] = ()

    @property
    def used(self) -> list[str]:
        """The labels whose points the table has, numbers in their order."""
        return sorted({name for own in self.pixels.values() for name in own}, key=natural)

    def to_dict(self, errors: Sequence[LabelErrors]) -> dict[str, Any]:
        """Return plain values, for JSON, with the errors of some sets.

        Parameters
        ----------
        errors
            The errors of each set.
        """
        paths = {"path": str(self.path), "points": str(self.table_path)}
        names = {"used": self.used, "left_out": list(self.left_out)}
        return {**paths, **names, "sets": [of_set.to_dict() for of_set in errors]}


@dataclass(frozen=True, eq=False)
class LabelErrors:
    """Distances of a set's points from their labels, px, by frame and label.

    ``without`` are the frames that have labels, but no pose with all joints that puts their points before the camera.
    """

    path: Path
    by_frame: Mapping[str, Mapping[str, float]]
    without: tuple[str, ...]

    @property
    def all(self) -> Float64:
        """All distances, (N,), px."""
        return np.array([error for own in self.by_frame.values() for error in own.values()])

    @property
    def by_label(self) -> dict[str, Float64]:
        """The distances (N,) of each label, px, in the order of the labels' first frames."""
        names = dict.fromkeys(name for own in self.by_frame.values() for name in own)
        return {name: np.array([own[name] for own in self.by_frame.values() if name in own]) for name in names}

    def table(self) -> Table:
        """Tabulate the errors of all labels, and of each by itself."""
        named = sorted(self.by_label.items(), key=lambda item: natural(item[0]))
        errors = {"all": self.all, **{f"label {name}": own for name, own in named}}
        rows = [
            (f"  {name}", str(len(own)), *(f"{value:.2f}" for value in summary_px(own).values()))
            for name, own in errors.items()
            if own.size
        ]
        head = f"{self.path}, {len(self.by_frame)} frames", "points", "mean", "median", "95 %", "largest, px"
        return Table(head, rows or [("  no frame has a pose", *[""] * 5)])

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        found = self.all
        return {
            "path": str(self.path),
            "frames": len(self.by_frame),
            "without": list(self.without),
            "points": len(found),
            "px": summary_px(found) if found.size else None,
            "by_label": {name: summary_px(own) for name, own in self.by_label.items()},
            "by_frame": {name: rounded_values(own) for name, own in self.by_frame.items()},
        }


def summary_px(errors: Float64) -> dict[str, float]:
    """Return mean, median, 95th percentile and largest of errors (N,), px."""
    numbers = {
        "mean": errors.mean(),
        "median": np.median(errors),
        "percentile_95": np.percentile(errors, 95),
        "largest": errors.max(),
    }
    return {name: round(float(value), 3) for name, value in numbers.items()}


def read_labels(session: Path, points: Path | None) -> Labels:
    """Read the labels of a session folder, its camera (the left one of two), and the table of their points.

    Parameters
    ----------
    session
        The folder, with markers.csv and a camera file.
    points
        The table; None for the bundled one that has most of the labels.

    Raises
    ------
    InputError
        A file is missing or not valid, or the table has none of the labels.
    """
    path = session / _LABELS
    pixels = read_detections(path)
    names = list(dict.fromkeys(name for own in pixels.values() for name in own))
    files = [points] if points is not None else [bundled_path("markers", name) for name in _TABLES]
    tables = {file: read_marker_table(file) for file in files}
    file = max(files, key=lambda file: len({*names} & {*tables[file]}))
    table = tables[file]
    left_out = tuple(name for name in names if name not in table)
    used = {frame: {name: own[name] for name in own if name in table} for frame, own in pixels.items()}
    used = {frame: own for frame, own in used.items() if own}
    if not used:
        raise InputError(f"{file}: markers: expected points of labels in {path}, got no {listed(left_out)}")
    return Labels(path, _camera(session), used, table, file, left_out)


def _camera(session: Path) -> Camera:
    """Read the camera of a session, the left one of two."""
    said, left = read_session_toml(session).camera, session / "left.yaml"
    usual = left if os.path.lexists(left) else session / "camera.yaml"
    return read_camera(said.left or said.file or usual, rectified=said.rectified, side="left")


def label_errors(compared: ComparedSet, labels: Labels, instrument: Instrument) -> LabelErrors:
    """Measure the distances of a set's points from their labels.

    Raises
    ------
    InputError
        No frame of the set has labels, or a link of the table is not in the instrument.
    """
    compared = compared.as_of(labels.pixels)
    if not set(compared.frames) & set(labels.pixels):
        raise InputError(
            f"{compared.path}: expected frames that {labels.path} has labels of ({listed(labels.pixels)}), "
            f"got {listed(compared.frames)}"
        )
    by_frame, without = {}, []
    for name, pixels in labels.pixels.items():
        if name not in compared.frames:
            continue
        found = _projected(compared.frames[name], labels, list(pixels), instrument)
        if found is None:
            without.append(name)
            continue
        away = np.linalg.norm(found - np.stack(list(pixels.values())), axis=1)
        by_frame[name] = dict(zip(pixels, away.tolist(), strict=True))
    return LabelErrors(compared.path, by_frame, tuple(without))


def _projected(frame: ComparedFrame, labels: Labels, names: list[str], instrument: Instrument) -> Float64 | None:
    """Return the pixels (N, 2) of some labels' points; None without a pose or joints, or behind the camera."""
    if frame.camera_from_root is None or any(name not in frame.joints for name in instrument.joint_names):
        return None
    joints = np.array([frame.joints[name] for name in instrument.joint_names])
    table = {name: labels.table[name] for name in names}
    placed = place_markers(instrument, joints, table)
    points = apply(frame.camera_from_root, np.stack([placed[name] for name in names]))
    return labels.camera.project(points) if points[:, 2].min() > 0 else None
