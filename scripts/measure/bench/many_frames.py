"""Sessions with many frames for measurements: the frames of one session, and their results, repeated."""

from __future__ import annotations

import csv
import itertools
import json
import shutil
from collections.abc import Container
from pathlib import Path

import cv2
import numpy as np

from dvrk_cmaes.errors import InputError


def repeated_session(source: Path, folder: Path, count: int, only: Container[str] | None = None) -> Path:
    """Write a session of ``count`` frames whose files are copies of those of a session, with its readings and tips.

    ``only`` are the names of the frames that are repeated, by default all.
    """
    masks = [path for path in sorted((source / "masks").iterdir()) if only is None or path.stem in only]
    if not masks:
        raise InputError(f"{source / 'masks'}: expected masks, got none")
    names = [(f"{k:05d}", mask) for k, mask in zip(range(count), itertools.cycle(masks), strict=False)]
    (folder / "masks").mkdir(parents=True)
    for name, mask in names:
        shutil.copyfile(mask, folder / "masks" / f"{name}{mask.suffix}")
        for image in (source / "images").glob(f"{mask.stem}.*"):
            (folder / "images").mkdir(exist_ok=True)
            shutil.copyfile(image, folder / "images" / f"{name}{image.suffix}")
    shutil.copy(source / "camera.yaml", folder)
    for table in (source / "joints.csv", source / "keypoints.csv"):
        if table.exists():
            _write_repeated(table, folder / table.name, [(name, mask.stem) for name, mask in names])
    return folder


def small_session(source: Path, folder: Path, shrink: int) -> Path:
    """Write a session with the masks of a session at 1 / ``shrink`` of their size, and its readings.

    The camera is that of the whole size, which is scaled to the masks' size when the frames are read.
    """
    (folder / "masks").mkdir(parents=True)
    for name in ("camera.yaml", "joints.csv"):
        shutil.copy(source / name, folder)
    for path in (source / "masks").iterdir():
        mask = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
        small = cv2.resize(mask, (mask.shape[1] // shrink, mask.shape[0] // shrink), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / "masks" / path.with_suffix(".png").name), small)
    return folder


def repeated_results(source: Path, folder: Path, count: int) -> Path:
    """Write ``count`` results, those of a folder of `batch` in the order of their frames and repeated.

    Overlays are copies of those of the folder.
    """
    documents = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((source / "frames").glob("*.json"))]
    (folder / "frames").mkdir(parents=True)
    for number, document in zip(range(count), itertools.cycle(documents), strict=False):
        name = f"{number:05d}"
        text = json.dumps({**document, "frame": name})
        (folder / "frames" / f"{name}.json").write_text(text, encoding="utf-8")
        (folder / "overlays").mkdir(exist_ok=True)
        drawn = source / "overlays" / f"{document['frame']}.jpg"
        if drawn.exists():
            shutil.copyfile(drawn, folder / "overlays" / f"{name}.jpg")
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
