"""Check of what results say about themselves: expected tip error, probability of the mode, and status.

The errors of results are compared with the truth: how often 90 % intervals contain it and how often it is beyond three
standard deviations, by quantity (frames in the right mode); the expected against the actual tip error, in bins; the
stated probability of the mode against the share of right modes; the area under the ROC curve of the expected error as a
test for tips more than a millimetre off, with the area that would be reached if the covariances were exactly right; and
how many results that are ok are good, and how many good ones are ok, by level and by recording. Good is a result in the
right mode whose tips are within 2 mm. Frames whose truth says that less than half of the jaws is visible do not count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, rankdata

from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.expected_error import INTERVAL, jacobian, tip_position
from measure.accuracy.calibration import distances
from measure.accuracy.errors import frame_errors
from measure.accuracy.figures import held_share, median_z
from measure.cases import Run, by_session, runs_by_level

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

GOOD_MM: Final = 2.0  # largest tip error of a good result
LEAST_VISIBLE: Final = 0.5  # share of the jaws
LARGE_MM: Final = 1.0  # tip error that the ROC curve tests for
_TIP_EDGES: Final = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, np.inf)  # mm
_MODE_EDGES: Final = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
_FAR: Final = float(chi2.sf(9.0, 1))  # probability beyond three standard deviations
_DRAWS: Final = 20  # simulations of the ROC curve


@dataclass(frozen=True, eq=False)
class Outcomes:
    """What N results state, and what is true.

    expected_mm, mode_probability, ok : stated. right_mode, tip_mm : true. squared, freedom : of the results in the
    right mode, squared Mahalanobis distances of each quantity from the truth, and degrees of freedom.
    """

    expected_mm: Float64
    mode_probability: Float64
    ok: Bool
    right_mode: Bool
    tip_mm: Float64
    squared: dict[str, Float64]
    freedom: dict[str, int]

    @classmethod
    def of(cls, instrument: Instrument, runs: Sequence[Run]) -> Outcomes:
        """Compare the results of runs with the truth."""
        errors = [frame_errors(instrument, run) for run in runs]
        right = [run for run, error in zip(runs, errors, strict=True) if error["right_mode"]]
        measured = [distances(instrument, run) for run in right]
        names = list(measured[0]) if measured else []
        stated = [run.result.mode_probability for run in runs]
        return cls(
            expected_mm=np.array(
                [run.result.expected_error.tip_mm["mean"] for run in runs if run.result.expected_error]
            ),
            mode_probability=np.array([np.nan if value is None else value for value in stated]),
            ok=np.array([run.trusted for run in runs]),
            right_mode=np.array([error["right_mode"] for error in errors]),
            tip_mm=np.array([error["tip_mm"] for error in errors]),
            squared={name: np.array([one[name][0] for one in measured]) for name in names},
            freedom={name: measured[0][name][1] for name in names},
        )


def interval_rows(outcomes: Outcomes) -> list[dict[str, Any]]:
    """Return for each quantity the share of 90 % intervals that contain the truth, and of errors beyond three sigma.

    ``from`` and ``to`` are the 95 % confidence interval of the first. With several degrees of freedom, three standard
    deviations are the distance that is exceeded with the same probability.
    """
    rows = []
    for name, squared in outcomes.squared.items():
        freedom = outcomes.freedom[name]
        rows.append(
            {"quantity": name, "results": len(squared)}
            | held_share(squared, freedom, INTERVAL)
            | {"beyond_3_sigma": float((squared > chi2.isf(_FAR, freedom)).mean())}
            | median_z(squared, freedom)
        )
    return rows


def tip_rows(outcomes: Outcomes) -> list[dict[str, Any]]:
    """Return the actual tip errors, mm, by bins of the expected ones: the reliability diagram of the tips."""
    rows = []
    for members, bounds in _bins(outcomes.expected_mm, _TIP_EDGES):
        actual = outcomes.tip_mm[members]
        rows.append(
            {
                "expected_mm": bounds,
                "results": len(actual),
                "mean_expected": float(outcomes.expected_mm[members].mean()),
            }
            | {"actual_rms": float(np.sqrt(np.mean(actual**2))), "actual_median": float(np.median(actual))}
            | {"actual_90": float(np.percentile(actual, 90))}
        )
    return rows


def mode_rows(outcomes: Outcomes) -> list[dict[str, Any]]:
    """Return the share of right modes by bins of the stated probability: the reliability diagram of the mode."""
    return [
        {
            "probability": bounds,
            "results": int(members.sum()),
            "mean_stated": float(outcomes.mode_probability[members].mean()),
            "right": float(outcomes.right_mode[members].mean()),
        }
        for members, bounds in _bins(outcomes.mode_probability, _MODE_EDGES)
    ]


def _bins(values: Float64, edges: Sequence[float]) -> list[tuple[Bool, list[float]]]:
    """Return the members of each bin that is not empty, and its bounds; the last bin includes its upper bound."""
    found = []
    for low, high in pairwise(edges):
        members = (values >= low) & ((values < high) | ((high == edges[-1]) & (values <= high)))
        if members.any():
            found.append((members, [low, high]))
    return found


def area_under_roc(score: Float64, positive: Bool) -> float | None:
    """Return the probability that a positive has a higher score than a negative; None without both."""
    count = int(positive.sum())
    if count in (0, len(positive)):
        return None
    return float((rankdata(score)[positive].sum() - count * (count + 1) / 2) / (count * (len(positive) - count)))


def attainable_area(instrument: Instrument, runs: Sequence[Run], score: Float64, seed: int = 0) -> float | None:
    """Return the area under the ROC curve if errors were drawn from the covariances, the mean of some draws."""
    rng = np.random.default_rng(seed)
    tips = [tip_position(instrument, [k]) for k in range(len(instrument.jaw_tips))]
    drawn = []
    for run in runs:
        at = run.at(instrument)
        changes = rng.multivariate_normal(np.zeros(len(run.covariance)), run.covariance, _DRAWS)
        slopes = [jacobian(tip, at) for tip in tips]
        drawn.append(1e3 * np.mean([np.linalg.norm(changes @ slope.T, axis=1) for slope in slopes], axis=0))
    areas = [area_under_roc(score, one > LARGE_MM) for one in np.array(drawn).T]
    known = [area for area in areas if area is not None]
    return float(np.mean(known)) if known else None


def status_row(outcomes: Outcomes) -> dict[str, Any]:
    """Return the shares of results that are ok, of those that are good, and of the good ones that are ok."""
    good = outcomes.right_mode & (outcomes.tip_mm < GOOD_MM)
    ok = outcomes.ok
    return {
        "results": len(ok),
        "ok": int(ok.sum()),
        "good": int(good.sum()),
        "good_of_ok": float(good[ok].mean()) if ok.any() else None,
        "ok_of_good": float(ok[good].mean()) if good.any() else None,
    }


def trust_report(instrument: Instrument, runs: Sequence[Run]) -> dict[str, list[Mapping[str, Any]]]:
    """Report the checks by level, and the statuses by recording as well."""
    posed = [run for run in runs if not run.failed and _is_visible(run)]
    levels = {name: (Outcomes.of(instrument, group), group) for name, group in runs_by_level(posed).items()}

    def by_name(rows: Callable[[Outcomes], list[dict[str, Any]]]) -> list[Mapping[str, Any]]:
        return [{"level": name, **row} for name, (outcomes, _) in levels.items() for row in rows(outcomes)]

    roc: list[Mapping[str, Any]] = [
        {
            "level": name,
            "results": len(group),
            "large": int((outcomes.tip_mm > LARGE_MM).sum()),
            "area": area_under_roc(outcomes.expected_mm, outcomes.tip_mm > LARGE_MM),
            "attainable": attainable_area(instrument, group, outcomes.expected_mm),
        }
        for name, (outcomes, group) in levels.items()
    ]
    return {
        "90 % intervals that hold the truth": by_name(interval_rows),
        "expected and actual tip error, mm": by_name(tip_rows),
        "stated probability of the mode and share of right modes": by_name(mode_rows),
        f"ROC of the expected tip error for more than {LARGE_MM:g} mm": roc,
        "status": by_name(lambda outcomes: [status_row(outcomes)]),
        "status by recording": [
            {"recording": name, **status_row(Outcomes.of(instrument, group))}
            for name, group in by_session(posed).items()
        ],
    }


def _is_visible(run: Run) -> bool:
    """Return whether at least half of the jaws is visible, according to the truth."""
    return run.case.truth is None or run.case.truth.visible >= LEAST_VISIBLE
