"""The paper's Table I: distances of the shafts' axes from one point while the arm moves about its remote centre.

Our method and three variants of PnP are run on synthetic sessions of three levels. If the paper's real frames are
available, our method is run on them and compared with the authors' published poses. Frames are solved one by one.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from measuring.report import markdown

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.evaluate.agreement import Agreement, measure_agreement
from dvrk_cmaes.evaluate.consistency import LEAST_FRAMES, TABLE_ONE
from dvrk_cmaes.evaluate.result_set import ResultSet, read_result_set
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.levels import LevelName
from experiments.made_sessions import OURS, PNP, PNP_RANSAC, PNP_TIPS, Made, errors_of, make, result_set, results_by
from experiments.parts import Claim, Options, new_figure, progress, write_experiment

LEVELS: Final[tuple[LevelName, ...]] = ("easy", "medium", "hard")
METHODS: Final = (OURS, PNP, PNP_RANSAC, PNP_TIPS)
MARKER_METHODS: Final = (PNP, PNP_RANSAC)
LARGEST_SHARE: Final = 0.2
"""Largest ratio of our sigma to that of PnP for which the claim holds."""
EARLIER, IN_TIME = "joints_4_frames_before.csv", ", readings in time"
"""File of readings of four frames earlier, beside those of frames whose images are four frames late; its label."""

AUTHORS, OURS_REAL = "authors' poses", "ours, real frames"
FULL, QUICK = (4, 10, None), (1, LEAST_FRAMES, LEAST_FRAMES)
"""Sizes of a run: sessions of a level, their frames, and largest number of real frames (None for all)."""


def made_rows(level: LevelName, sessions: Sequence[Made], methods: Sequence[str]) -> list[dict[str, Any]]:
    """Return one row for each method: medians of the measures of agreement over the sessions."""
    rows = []
    for method in methods:
        results = results_by(method, sessions, EstimateConfig(), f"{level}, {method}")
        sets = [result_set(level, made, found) for made, found in zip(sessions, results, strict=True)]
        measured = [measure_agreement(one) for one in sets if len(one.frames) >= LEAST_FRAMES]
        tips = [e.tip_mm for e in errors_of(sessions, results) if e is not None and e.tip_mm is not None]
        rows.append(
            {
                "frames": f"made, {level}",
                "method": method,
                "sessions": len(measured),
                "without_pose": sum(len(one.failed) for one in sets),
                **agreement_figures(measured),
                "tip_mm_median": round(float(np.median(tips)), 3) if tips else None,
            }
        )
    return rows


def agreement_figures(measured: Sequence[Agreement]) -> dict[str, Any]:
    """Return the medians of the measures over sessions, and the sigma of each session, m."""
    sigmas = [one.axes.sigma for one in measured]
    rcm = [one.rcm.rms for one in measured if one.rcm is not None]
    base = [one.base.median_deg for one in measured if one.base is not None]
    return {
        "sigma_m": _median(sigmas, 9),
        "sigma_m_each": [round(value, 9) for value in sigmas],
        "rms_m": _median([one.axes.rms for one in measured], 9),
        "rcm_spread_mm": _median([1e3 * value for value in rcm], 3),
        "base_rotation_deg_median": _median(base, 2),
    }


def _median(values: Sequence[float], digits: int) -> float | None:
    """Return the rounded median; None without values."""
    return round(float(np.median(values)), digits) if len(values) else None


def real_rows(shared: Path, frames: int | None) -> list[dict[str, Any]]:
    """Return the rows of the paper's real frames; no rows if the frames are not available.

    There are rows of the authors' poses, and of our poses with the scanned instrument for at most ``frames`` frames; if
    ``frames`` is 0, our rows are left out. Where the images are known to be later than the readings, there are the same
    rows with the readings of the moments that the images show.
    """
    rows: list[dict[str, Any]] = []
    urdf = shared / "instruments" / "lnd_400006" / "lnd_400006.urdf"
    for level in ("easy", "medium"):
        folder = shared / "frames" / "real" / level
        if not (folder / "published.csv").exists():
            print(f"{folder}: not there; the paper's real frames are left out", file=sys.stderr)
            continue
        for label, joints in ((f"real, {level}", "joints.csv"), (f"real, {level}{IN_TIME}", EARLIER)):
            readings = folder / joints
            if not readings.exists():
                continue
            authors = read_result_set(folder / "published.csv", readings)
            rows.append(_real_row(label, AUTHORS, measure_agreement(authors)))
            if urdf.exists() and frames != 0:
                own = _estimated(folder, readings, str(urdf), frames)
                rows.append(_real_row(label, OURS_REAL, measure_agreement(own)))
    return rows


def _real_row(frames: str, method: str, measured: Agreement) -> dict[str, Any]:
    """Return a row of one set of real frames."""
    failed = len(measured.results.failed)
    return {"frames": frames, "method": method, "sessions": 1, "without_pose": failed, **agreement_figures([measured])}


def _estimated(folder: Path, readings: Path, urdf: str, frames: int | None) -> ResultSet:
    """Estimate the first ``frames`` frames of a session folder, or all, by our method, with a file of readings."""
    session, body = read_session(folder, joints=[readings]), prepare(urdf)
    chosen = session.frames if frames is None else session.frames[:frames]
    poses = {}
    for k, files in enumerate(chosen, start=1):
        data = read_frame(files, session.camera)
        result = estimate(data.mask, data.camera, files.readings, body, ignore=data.ignore, frame=files.name)
        if result.camera_from_root is not None:
            poses[files.name] = result.camera_from_root
        progress(f"real, {folder.name}", k, len(chosen))
    return ResultSet(
        name=folder.name,
        frames=tuple(poses),
        camera_from_root=np.stack(list(poses.values())),
        readings={files.name: files.readings for files in chosen},
    )


def claims_of(rows: Sequence[dict[str, Any]]) -> list[Claim]:
    """Evaluate the claims about the table."""
    sigma = {(row["frames"], row["method"]): row["sigma_m"] for row in rows}
    claims = []
    published = {level: sigma.get((f"real, {level}", AUTHORS)) for level in ("easy", "medium")}
    if all(value is not None for value in published.values()):
        same = all(round(value or 0.0, 5) == TABLE_ONE[level].sigma_m for level, value in published.items())
        figures = ", ".join(f"{level} {value:.5f} m" for level, value in published.items())
        claims.append(Claim("the authors' poses give the paper's figures, 0.00046 and 0.00243 m", same, figures))
    for level in LEVELS:
        ours, pnp = sigma.get((f"made, {level}", OURS)), [sigma.get((f"made, {level}", m)) for m in MARKER_METHODS]
        known = [value for value in pnp if value is not None]
        if ours is not None and known:
            share = ours / min(known)
            text = f"{level}: our sigma is a fifth of PnP's from painted markers, or less"
            claims.append(Claim(text, share <= LARGEST_SHARE, f"{share:.2f} of the better PnP's {min(known):.5f} m"))
    for level in ("easy", "medium"):
        ours = sigma.get((f"real, {level}", OURS_REAL))
        if ours is not None:
            theirs = TABLE_ONE[level].sigma_m
            text = f"real, {level}: our sigma is below the authors'"
            claims.append(Claim(text, ours < theirs, f"{ours:.5f} against {theirs:.5f} m"))
    return claims


def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Draw the sigma of each session by level and method, and the paper's figures."""
    figure = new_figure(9.0, 4.6)
    panel = figure.subplots()
    names = [*(f"made, {level}" for level in TABLE_ONE), "real, easy", "real, medium", f"real, medium{IN_TIME}"]
    methods = [*METHODS, AUTHORS, OURS_REAL]
    for k, method in enumerate(methods):
        points = [
            (names.index(row["frames"]) + (k - 2) * 0.1, sigma)
            for row in rows
            if row["method"] == method
            for sigma in row["sigma_m_each"]
        ]
        if points:
            panel.plot(*zip(*points, strict=True), "os^dPX"[k], label=method, markersize=6, alpha=0.75)
    for level, row in TABLE_ONE.items():
        place = list(TABLE_ONE).index(level) + 0.35
        panel.plot([place], [row.sigma_m], "k*", label="paper, its method (real frames)" if level == "easy" else None)
        panel.plot([place], [row.pnp_sigma_m], "kx", label="paper, PnP (real frames)" if level == "easy" else None)
    panel.set_yscale("log")
    panel.set_xticks(range(len(names)), [name.replace(", ", "\n") for name in names])
    panel.set_ylabel("sigma of the axes about x*, m")
    panel.grid(axis="y", alpha=0.3)
    panel.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def as_table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as a Markdown table, followed by the paper's rows."""
    columns = ("frames", "method", "sigma, m", "rms, mm", "RCM spread, mm", "base, deg", "tips, mm", "without pose")
    cells = [
        (
            row["frames"],
            row["method"],
            _shown(row["sigma_m"], 5),
            _shown(row["rms_m"], 2, 1e3),
            _shown(row["rcm_spread_mm"], 2),
            _shown(row["base_rotation_deg_median"], 1),
            _shown(row.get("tip_mm_median"), 2),
            str(row["without_pose"]),
        )
        for row in rows
    ]
    for level, paper in TABLE_ONE.items():
        for method, sigma in (("paper, its method", paper.sigma_m), ("paper, PnP", paper.pnp_sigma_m)):
            cells.append((f"paper's, {level}", method, f"{sigma:.5f}", "", "", "", "", ""))
    return markdown(columns, cells)


def _shown(value: float | None, digits: int, factor: float = 1.0) -> str:
    """Format a number multiplied by a factor; empty for None."""
    return "" if value is None else f"{value * factor:.{digits}f}"


def run(options: Options) -> None:
    """Run the experiment and write its files."""
    count, frames, real = QUICK if options.quick else FULL
    body = prepare("lnd")
    rows = []
    for level in LEVELS:
        sessions = [make(body, level, frames, 100 + options.seed + k) for k in range(count)]
        rows += made_rows(level, sessions, METHODS)
    rows += real_rows(options.shared, real)
    write_experiment(
        options,
        "table1",
        title="Table I: how nearly the shafts' axes meet",
        figures={"rows": rows, "paper": {k: vars(v) for k, v in TABLE_ONE.items()}},
        claims=claims_of(rows),
        table=as_table(rows),
        picture=draw(rows),
        note=(
            f"Made frames: medians over {count} sessions of {frames} frames (`dvrk-cmaes synth "
            "--motion rcm`). Sigma is the standard deviation of the axes' distances from x*, the paper's figure; rms "
            "does not forgive a constant distance. PnP sees all painted markers that its detector finds, those on the "
            "far side too, and no false ones; tips and shaft edges are what keypoints alone can do. The paper's own "
            "PnP worked on real detections. The images of real, medium are four frames later than the readings beside "
            "them; its last rows have the readings of four frames earlier, which change our poses through the wrist's "
            "readings, and RCM and base through the outer joints'."
        ),
    )
