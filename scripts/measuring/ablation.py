"""Ablation: drawn frames with known truth, each solved by variants of the search, with and without readings.

A pose is found if it is within 12 degrees of the truth and 20 degrees in each joint, or of the truth's mirror twin,
which an outline without readings hardly distinguishes from it.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import binomtest

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.evaluate.pose_error import PoseError, compare_poses
from dvrk_cmaes.io.json_file import write_json
from dvrk_cmaes.pose.search import METHODS
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.levels import LEVELS, LevelName
from dvrk_cmaes.synth.session import SessionPlan, make_frames, make_truths
from measuring.report import Report, in_processes

FOUND_DEG: Final = 12.0, 20.0
"""Largest rotation from the truth or its mirror twin, and largest difference of a joint, of a pose that is found."""
LEVEL_NAMES: Final[tuple[LevelName, ...]] = ("easy", "medium", "hard")
DRAWN: Final = (*product(LEVEL_NAMES, ((320, 240), (640, 480), (1280, 1024)), ("lnd", "maryland")),)
"""Level, size of the image, px, and instrument of the sessions of a set."""


def variants(config: EstimateConfig) -> Iterator[tuple[str, EstimateConfig]]:
    """Yield names of variants with their settings; the first is the configuration itself."""
    search = config.search
    yield "as it is", config
    yield "optimiser off", replace(config, search=replace(search, evaluations=1))
    for field in fields(config.weights):
        if field.name not in ("line_offset", "found_tips"):  # of found tips, no keypoints is the same
            yield f"loss: no {field.name}", replace(config, weights=replace(config.weights, **{field.name: 0.0}))
    yield "silhouettes: count", replace(config, silhouette=replace(config.silhouette, method="count"))
    yield "seeds: no shaft edges", replace(config, search=replace(search, use_edges=False))
    yield "seeds: shaft edges alone", replace(config, search=replace(search, free_share=0.0))
    for method in METHODS[::-1]:
        if method != search.method:
            yield f"search: {method}", replace(config, search=replace(search, method=method))
    yield "refinement: differences", replace(config, refine=replace(config.refine, derivatives="differences"))


def solved(number: int, seed: int, frames: int, names: Sequence[str], kept: Path) -> list[dict[str, Any]]:
    """Draw a session, and solve its frames by some variants in turns; rows that were kept in a file are reused."""
    if kept.exists():
        return list(json.loads(kept.read_text(encoding="utf-8")))
    level, (width, height), instrument = DRAWN[number]
    body, focal, rows = prepare(instrument), 1.6 * width, list[dict[str, Any]]()
    camera = Camera(width, height, focal, focal, 0.503 * width, 0.496 * height, distortion=LEVELS[level].distortion)
    plan = SessionPlan(body, camera, LEVELS[level], "free", frames, 100 * seed + number, {})
    chosen = [(name, config) for name, config in variants(EstimateConfig(threads=1)) if name in names]
    for frame in make_frames(plan, make_truths(plan)[1]):
        true = frame.truth.camera_from_root, frame.truth.joints
        pose, joints = body.instrument.twin(true[0], np.array([true[1][name] for name in body.instrument.joint_names]))
        twin = pose, dict(zip(body.instrument.joint_names, joints.tolist(), strict=True))
        for (name, config), given in product(chosen, (frame.readings, {})):
            began = time.process_time()
            result = estimate(frame.mask, camera, given, body, ignore=frame.ignore, config=config)
            row = {"variant": name, "readings": bool(given), "seconds": time.process_time() - began}
            assert result.camera_from_root is not None
            found = result.camera_from_root, result.joints
            right, other = (compare_poses(body.instrument, found, truth) for truth in (true, twin))
            rows.append(row | {"right": _is_found(right), "twin": _is_found(other), "tip_mm": right.tip_mm})
    kept.parent.mkdir(parents=True, exist_ok=True)
    write_json(kept, rows)
    return rows


def _is_found(error: PoseError) -> bool:
    return error.rotation_deg < FOUND_DEG[0] and error.joint_deg is not None and error.joint_deg < FOUND_DEG[1]


def _figures(name: str, rows: Sequence[dict[str, Any]], usual: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of a variant: found modes, which of them only the ``usual`` search finds or it does not, tips."""
    found, of_usual = (np.array([row["right"] or row["twin"] for row in each]) for each in (rows, usual))
    low, high = binomtest(int(found.sum()), len(rows)).proportion_ci(method="wilson")
    tips = [row["tip_mm"] for row in rows if row["right"]]
    return {
        "variant": name,
        "frames": len(rows),
        "found": int(found.sum()),
        "95 % interval": [float(low), float(high)],
        "lost, gained": [int((of_usual & ~found).sum()), int((found & ~of_usual).sum())],
        "right": sum(row["right"] for row in rows),
        "mirror twin": sum(row["twin"] for row in rows),
        "tips of the right, mm, median, 95 %": np.percentile(tips, [50, 95]).tolist() if tips else None,
        "s a frame": float(np.mean([row["seconds"] for row in rows])),
    }


def ablation_report(options: argparse.Namespace) -> Report:
    """Solve all sets of sessions by the variants, and return a table with and one without readings."""
    names = [name for name, _ in variants(EstimateConfig()) if name in (options.variants or [name])]
    sessions = product(options.seeds, range(len(DRAWN)))
    tasks = [(k, seed, options.frames, names, options.keep / f"{seed}-{k}.json") for seed, k in sessions]
    rows = [row for of_one in in_processes(solved, tasks, options.workers, "sessions") for row in of_one]
    report: dict[str, list[dict[str, Any]]] = {}
    for title, given in (("with readings", True), ("without readings", False)):
        of_names = [[row for row in rows if (row["variant"], row["readings"]) == (name, given)] for name in names]
        report[title] = [_figures(name, each, of_names[0]) for name, each in zip(names, of_names, strict=True)]
    return report
