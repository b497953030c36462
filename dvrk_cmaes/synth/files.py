"""The readings of synthetic frames as joints.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.json_file import write_text


def write_joints(path: str | Path, readings: Mapping[str, Mapping[str, float]], columns: Sequence[str]) -> None:
    """Write a joints.csv with the columns frame and ``columns``, from readings by frame and joint, rad and m."""
    rows = ([frame, *(f"{reading[name]:.6f}" for name in columns)] for frame, reading in readings.items())
    write_text(path, csv_text(["frame", *columns], rows))
