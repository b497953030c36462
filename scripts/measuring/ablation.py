"""Ablation: frames of sessions with truth, each solved by variants of the search, with or without readings.

A pose is found if it is within 12 degrees of the truth and 20 degrees in each joint, or of the truth's mirror twin,
which an outline without readings hardly distinguishes from it.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import binomtest

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.geometry import rotation_angle
from dvrk_cmaes.io.json_file import write_json
from dvrk_cmaes.pose.search import METHODS
from dvrk_cmaes.silhouette.prepare import prepare
from measuring.report import Report

FOUND_DEG: Final = 12.0, 20.0
"""Largest rotation from the truth or its mirror twin, and largest difference of a joint, of a pose that is found."""
UNCHANGED: Final = "as it is"


def variants(config: EstimateConfig) -> Iterator[tuple[str, EstimateConfig]]:
    """Yield names of variants with their settings; the first is the configuration itself."""
    search = config.search
    yield UNCHANGED, config
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


def solved(config: EstimateConfig, folders: Sequence[Path], most: int, *, readings: bool) -> list[dict[str, Any]]:
    """Solve the first frames of each folder, and compare them with the truth."""
    body = prepare("lnd")
    names, rows = body.instrument.joint_names, []
    for folder in folders:
        session = read_session(folder)
        golden = json.loads((folder / "golden.json").read_text(encoding="utf-8"))["frames"]
        for files in session.frames[:most]:
            data, truth = read_frame(files, session.camera), golden[files.name]
            true = np.array(truth["T_camera_roll_link"]), np.array([truth["joints"][name] for name in names])
            began = time.process_time()
            result = estimate(data.mask, data.camera, files.readings if readings else {}, body, config=config)
            row: dict[str, Any] = {"seconds": time.process_time() - began}
            if result.camera_from_root is not None:
                joints = np.array([result.joints[name] for name in names])
                row["right"], row["twin"] = (
                    bool(
                        np.degrees(rotation_angle(pose, result.camera_from_root)) < FOUND_DEG[0]
                        and np.degrees(np.abs(values - joints)).max() < FOUND_DEG[1]
                    )
                    for pose, values in (true, body.instrument.twin(*true))
                )
                truly = true[0], dict(zip(names, true[1].tolist(), strict=True))
                row["tip_mm"] = compare_poses(body.instrument, (result.camera_from_root, result.joints), truly).tip_mm
            rows.append(row)
    return rows


def _figures(name: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of a variant: found modes with their interval, right ones, twins, tips, seconds."""
    right, twins = (sum(row.get(which, False) for row in rows) for which in ("right", "twin"))
    low, high = binomtest(right + twins, len(rows)).proportion_ci(method="wilson")
    tips = [row["tip_mm"] for row in rows if row.get("right")]
    return {
        "variant": name,
        "frames": len(rows),
        "found": right + twins,
        "95 % interval": [low, high],
        "right": right,
        "mirror twin": twins,
        "tips of the right, mm, median": float(np.median(tips)) if tips else None,
        "95 %": float(np.percentile(tips, 95)) if tips else None,
        "s a frame": float(np.mean([row["seconds"] for row in rows])),
    }


def ablation_report(options: argparse.Namespace) -> Report:
    """Solve the frames by all variants, and return the table."""
    found = []
    for name, config in variants(EstimateConfig(threads=1)):
        kept = options.keep / f"{name.replace(': ', '_').replace(' ', '_')}.json" if options.keep else None
        if kept is not None and kept.exists():
            rows = json.loads(kept.read_text(encoding="utf-8"))
        else:
            rows = solved(config, options.folders, options.frames, readings=options.readings)
            if kept is not None:
                kept.parent.mkdir(parents=True, exist_ok=True)
                write_json(kept, rows)
        print(name, file=sys.stderr, flush=True)
        found.append(_figures(name, rows))
    return {"ablation": found}
