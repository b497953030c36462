"""Small sessions and settings for fast batches, and the comparable part of a batch's output."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2

from dvrk_cmaes import EstimateConfig
from helpers.files import read_mask
from helpers.places import bundled_path

QUICK = """
[search]
samples = 64
starts = 1
evaluations = 20
[refine.outline]
iterations = 4
"""
"""Settings for tests that need results quickly; their accuracy is low."""

_USUAL = EstimateConfig()
QUICK_CONFIG = replace(
    _USUAL,
    search=replace(_USUAL.search, samples=64, starts=1, evaluations=20),
    refine=replace(_USUAL.refine, outline=replace(_USUAL.refine.outline, iterations=4)),
)


def make_session(folder: Path, names: list[str]) -> Path:
    """Write a session of the bundled frames, repeated in turn, at a quarter of their size; returns the folder."""
    demo = bundled_path("demo")
    (folder / "masks").mkdir(parents=True)
    shutil.copy(demo / "camera.yaml", folder)
    header, *rows = (demo / "joints.csv").read_text(encoding="utf-8").splitlines()
    lines = [header]
    for k, name in enumerate(names):
        row = rows[k % len(rows)].split(",")
        mask = cv2.resize(read_mask(demo / "masks" / f"{row[0]}.png").astype("uint8") * 255, (160, 120))
        (folder / "masks" / f"{name}.png").write_bytes(cv2.imencode(".png", mask)[1].tobytes())
        lines.append(",".join([f'"{name}"', *row[1:]]))
    (folder / "joints.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def comparable(out: Path) -> dict[str, str]:
    """Give the texts of all files of results by name, without times, and without their digests."""
    files = sorted(path for path in out.rglob("*") if path.is_file() and not path.name.startswith("."))
    return {str(path.relative_to(out)): _without_times(path) for path in files}


def _without_times(path: Path) -> str:
    text = path.read_bytes().decode("latin-1")
    if path.name == "summary.json":
        return re.sub(r'"timing": \{.*?\n \},', "", text, flags=re.DOTALL)
    if path.name == "report.html":
        return "a page"  # it states times
    if path.name == "run.json":
        return text.partition('"frames": {')[0]  # without times of files, and digests of files with times
    if path.suffix == ".json":
        return re.sub(r'"seconds": [0-9.]+,', "", text)
    if path.suffix == ".csv":
        header, *rows = text.splitlines()
        at = header.split(",").index("seconds")
        return "\n".join(_without_cell(row, at) for row in (header, *rows))
    return text


def _without_cell(row: str, at: int) -> str:
    return ",".join(cell for k, cell in enumerate(row.split(",")) if k != at)
