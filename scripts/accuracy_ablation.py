"""What each part is worth: the same frames with a loss, edges or readings left out, or with other methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from accuracy_cases import Case, Run
from accuracy_errors import frame_errors

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.refine import METHODS as REFINEMENTS
from dvrk_cmaes.search import METHODS as SEARCHES


@dataclass(frozen=True)
class Variant:
    """One way to estimate the frames; ``readings`` says whether they are given."""

    name: str
    config: EstimateConfig
    readings: bool = True

    def changed(self, case: Case) -> Case:
        """Return the case as this variant is handed it."""
        return case if self.readings else replace(case, readings={})


def variants(config: EstimateConfig) -> list[Variant]:
    """All variants of a configuration, itself first."""
    found = [Variant("as it is", config)]
    for name in [field.name for field in fields(config.weights) if field.name != "line_offset"]:
        found.append(Variant(f"loss: no {name}", replace(config, weights=replace(config.weights, **{name: 0.0}))))
    found += [
        Variant("seeds: shaft edges not used", replace(config, search=replace(config.search, use_edges=False))),
        Variant(
            "seeds: shaft edges only",
            replace(config, search=replace(config.search, free_share=1 / config.search.samples)),
        ),
        Variant("readings: none given", config, readings=False),
    ]
    for method in SEARCHES:
        if method != config.search.method:
            found.append(Variant(f"search: {method}", replace(config, search=replace(config.search, method=method))))
    for method in REFINEMENTS:
        if method != config.refine.method:
            found.append(
                Variant(f"refinement: {method}", replace(config, refine=replace(config.refine, method=method)))
            )
    return found


def ablation_report(instrument: Instrument, results: Mapping[str, Sequence[Run]]) -> list[dict[str, Any]]:
    """One row a variant: share in the right mode, median and largest-tenth errors, seconds a frame."""
    rows = []
    for name, runs in results.items():
        errors = [frame_errors(instrument, run) for run in runs if not run.failed]
        row: dict[str, Any] = {"variant": name, "frames": len(runs)}
        if errors:
            row["right_mode"] = sum(e["right_mode"] for e in errors) / len(runs)
            row["tip_mm"] = float(np.median([e["tip_mm"] for e in errors]))
            row["tip_mm_90"] = float(np.percentile([e["tip_mm"] for e in errors], 90))
            row["axis_deg"] = float(np.median([e["axis_deg"] for e in errors]))
        row["seconds"] = float(np.median([run.result["seconds"] for run in runs]))
        rows.append(row)
    return rows
