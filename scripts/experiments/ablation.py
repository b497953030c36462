"""Ablation: the same frames without a loss term, shaft edges or readings, or with other methods.

    python scripts/experiments/ablation.py [--quick]

The frames are synthetic, of the levels medium and hard. All variants are run on the same frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from experiment import Claim, Options, progress, read_options, table, write_experiment
from figure import new_figure
from made_sessions import RIGHT_MODE_DEG, Made, by_estimate, error_of, make

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evaluate.pose_error import PoseError
from dvrk_cmaes.pose.search import METHODS as SEARCHES
from dvrk_cmaes.silhouette import METHODS as SILHOUETTES
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.levels import LevelName

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEVELS: Final[tuple[LevelName, ...]] = ("medium", "hard")
UNCHANGED: Final = "as it is"
_COLOURS: Final = {"medium": "#1d3557", "hard": "#e76f51"}


@dataclass(frozen=True)
class Size:
    """Size of a run: number of frames of each level, and largest number of variants (None for all)."""

    frames: int
    variants: int | None


FULL: Final = Size(frames=12, variants=None)
QUICK: Final = Size(frames=1, variants=4)


@dataclass(frozen=True)
class Variant:
    """A variant of the method; ``readings`` states whether readings are used."""

    name: str
    config: EstimateConfig
    readings: bool = True


def variants(config: EstimateConfig) -> list[Variant]:
    """Return all variants of a configuration; the first one is the configuration itself."""
    found = [Variant(UNCHANGED, config)]
    for name in [field.name for field in fields(config.weights) if field.name != "line_offset"]:
        found.append(Variant(f"loss: no {name}", replace(config, weights=replace(config.weights, **{name: 0.0}))))
    found += [
        Variant("search: optimiser off", replace(config, search=replace(config.search, evaluations=1))),
        Variant("refinement: differences", replace(config, refine=replace(config.refine, derivatives="differences"))),
        Variant("seeds: shaft edges not used", replace(config, search=replace(config.search, use_edges=False))),
        Variant(
            "seeds: shaft edges only",
            replace(config, search=replace(config.search, free_share=1 / config.search.samples)),
        ),
        Variant("readings: none given", config, readings=False),
    ]
    for name, part, methods in (
        ("silhouettes", "silhouette", SILHOUETTES),
        ("search", "search", SEARCHES),
    ):
        own = getattr(config, part)
        others = [method for method in methods if method != own.method]
        found += [Variant(f"{name}: {one}", replace(config, **{part: replace(own, method=one)})) for one in others]
    return found


@dataclass(frozen=True, eq=False)
class Outcome:
    """Error of a frame by a variant, None without a pose, and its time in seconds."""

    error: PoseError | None
    seconds: float

    @property
    def tip_mm(self) -> float:
        """Error of the tips, mm; infinite without a pose."""
        return float("inf") if self.error is None or self.error.tip_mm is None else self.error.tip_mm

    @property
    def right_mode(self) -> bool:
        """Whether the pose is in the true mode."""
        return self.error is not None and self.error.rotation_deg < RIGHT_MODE_DEG


def outcomes_of(variant: Variant, sessions: Sequence[Made]) -> list[Outcome]:
    """Estimate all frames of sessions by a variant."""
    found = []
    total = sum(len(made.frames) for made in sessions)
    for made in sessions:
        for frame in made.frames:
            given = frame if variant.readings else replace(frame, readings={})
            result = by_estimate(made, given, variant.config)
            found.append(Outcome(error_of(frame, result), result.seconds))
            progress(variant.name, len(found), total)
    return found


def row_of(name: str, level: str, found: Sequence[Outcome], unchanged: Sequence[Outcome]) -> dict[str, Any]:
    """Return a row: share in the right mode, error percentiles, seconds, and numbers of worse and better frames."""
    tips = np.array([one.tip_mm for one in found])
    axes = [one.error.shaft_deg for one in found if one.error is not None]
    worse = [one.tip_mm > 1.1 * base.tip_mm for one, base in zip(found, unchanged, strict=True)]
    better = [1.1 * one.tip_mm < base.tip_mm for one, base in zip(found, unchanged, strict=True)]
    return {
        "variant": name,
        "level": level,
        "frames": len(found),
        "right_mode": sum(one.right_mode for one in found) / len(found),
        "tip_mm_median": _finite(np.median(tips)),
        "tip_mm_90": _finite(np.percentile(tips, 90)),
        "axis_deg_median": _finite(np.median(axes)) if axes else None,
        "worse": sum(worse),
        "better": sum(better),
        "seconds_median": round(float(np.median([one.seconds for one in found])), 2),
    }


def _finite(value: float) -> float | None:
    """Round a number to three decimals; None if it is not finite."""
    return round(float(value), 3) if np.isfinite(value) else None


def claims_of(rows: Sequence[dict[str, Any]]) -> list[Claim]:
    """Evaluate the claim that no variant is better than the unchanged method."""
    ahead = [f"{r['variant']} ({r['level']}: {r['better']} to {r['worse']})" for r in rows if r["better"] > r["worse"]]
    text = "no variant is better (tips off by a tenth less) in more frames than it is worse in"
    return [Claim(text, not ahead, "ahead: " + ", ".join(ahead) if ahead else "none is ahead")]


def as_table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as a Markdown table with the levels side by side."""
    columns = ["variant"]
    for level in LEVELS:
        columns += [f"{level}: right mode", "tips, median / 90 %, mm", "worse / better"]
    lines = []
    for name in dict.fromkeys(row["variant"] for row in rows):
        cells: list[object] = [name]
        seconds = []
        for level in LEVELS:
            (row,) = (r for r in rows if r["variant"] == name and r["level"] == level)
            tips = " / ".join("-" if row[key] is None else f"{row[key]:.2f}" for key in ("tip_mm_median", "tip_mm_90"))
            cells += [f"{row['right_mode']:.0%}", tips, f"{row['worse']} / {row['better']}"]
            seconds.append(row["seconds_median"])
        lines.append([*cells, f"{np.mean(seconds):.1f}"])
    return table([*columns, "s a frame"], lines)


def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Draw the tips' median error and the share of frames in a wrong mode, by variant and level."""
    names = list(dict.fromkeys(row["variant"] for row in rows))
    figure = new_figure(8.0, 1.0 + 0.26 * len(names))
    left, right = figure.subplots(1, 2, sharey=True)
    for k, level in enumerate(LEVELS):
        colour = _COLOURS[level]
        chosen = [row for row in rows if row["level"] == level]
        places = np.arange(len(names)) + (k - 0.5) * 0.36
        left.barh(places, [row["tip_mm_median"] or 0.0 for row in chosen], height=0.34, color=colour, label=level)
        right.barh(places, [1 - row["right_mode"] for row in chosen], height=0.34, color=colour)
    left.set_yticks(range(len(names)), names, fontsize=8)
    left.invert_yaxis()
    left.set_xlabel("error of the tips, median, mm")
    right.set_xlabel("share of frames in a wrong mode")
    right.set_xlim(0, 1)
    right.legend(*left.get_legend_handles_labels(), fontsize=8, loc="lower right")
    for panel in (left, right):
        panel.grid(axis="x", alpha=0.3)
    return figure


def run(options: Options, size: Size) -> None:
    """Run the experiment and write its files."""
    body = prepare("lnd")
    sessions = {level: make(body, level, size.frames, 900 + options.seed) for level in LEVELS}
    rows: list[dict[str, Any]] = []
    first: dict[str, list[Outcome]] = {}
    for variant in variants(EstimateConfig())[: size.variants]:
        for level, made in sessions.items():
            found = outcomes_of(variant, [made])
            first.setdefault(level, found)
            rows.append(row_of(variant.name, level, found, first[level]))
    write_experiment(
        options,
        "ablation",
        title="Ablation: losses, seeds, searches and refinements",
        figures={"rows": rows},
        claims=claims_of(rows),
        tables=[as_table(rows)],
        picture=draw(rows),
        notes=[
            f"{size.frames} frames of each level (`dvrk-cmaes synth --motion rcm`). Worse and better: in how many "
            "frames the tips are off by a tenth more, or less, than with everything as it is."
        ],
    )


if __name__ == "__main__":
    chosen = read_options(__doc__ or "")
    run(chosen, QUICK if chosen.quick else FULL)
