"""Sessions with many frames for measurements of batches: the frames of one session repeated as symbolic links."""

from __future__ import annotations

import csv
import itertools
import shutil
from pathlib import Path

from dvrk_cmaes.errors import InputError


def repeated_session(source: Path, folder: Path, count: int) -> Path:
    """Write a session of ``count`` frames whose files are links to those of a session, with its readings and tips."""
    masks = sorted((source / "masks").iterdir())
    if not masks:
        raise InputError(f"{source / 'masks'}: expected masks, got none")
    names = [(f"{k:05d}", mask) for k, mask in zip(range(count), itertools.cycle(masks), strict=False)]
    (folder / "masks").mkdir(parents=True)
    for name, mask in names:
        (folder / "masks" / f"{name}{mask.suffix}").symlink_to(mask.resolve())
        for image in (source / "images").glob(f"{mask.stem}.*"):
            (folder / "images").mkdir(exist_ok=True)
            (folder / "images" / f"{name}{image.suffix}").symlink_to(image.resolve())
    shutil.copy(source / "camera.yaml", folder)
    for table in (source / "joints.csv", source / "keypoints.csv"):
        if table.exists():
            _write_repeated(table, folder / table.name, [(name, mask.stem) for name, mask in names])
    return folder


def _write_repeated(table: Path, target: Path, names: list[tuple[str, str]]) -> None:
    """Write a table with the rows of other frames; ``names`` are pairs of a new frame and the frame it repeats."""
    with table.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        rows = {row["frame"]: row for row in reader}
    with target.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, reader.fieldnames or [])
        writer.writeheader()
        writer.writerows({**rows[old], "frame": new} for new, old in names if old in rows)
