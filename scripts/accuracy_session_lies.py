"""Sessions in which something is false: a calibration that is honest names it, and does not average over it.

Each kind of lie falsifies one thing of a session with known truth: masks of another session in three of its frames,
readings two frames late, a base that moved half way, or the wrong arm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from accuracy_cases import Case, Run
from accuracy_session import Outcome, Trial, base_error

from dvrk_cmaes.calibration import SessionCalibration

STRANGERS: Final = "3 masks of another session"
LATE: Final = "readings 2 frames late"
MOVED: Final = "base moved half way"
ARM: Final = "wrong arm"

_LATE_BY: Final = 2
_STRANGE: Final = (0.1, 0.5, 0.8)  # where in the session they are


def false_cases(sessions: Mapping[str, Sequence[Case]]) -> list[Case]:
    """Make the frames that must be estimated anew: those with strange masks, and those with late readings."""
    made = []
    for name, cases in sessions.items():
        other = _other(sessions, name)
        for k in _strange(len(cases)):
            stranger = other[k % len(other)]
            made.append(replace(cases[k], kind=STRANGERS, mask=stranger.mask, ignore=stranger.ignore, truth=None))
        for k in range(_LATE_BY, len(cases)):
            made.append(replace(cases[k], kind=LATE, readings=cases[k - _LATE_BY].readings))
    return made


def _strange(count: int) -> list[int]:
    return sorted({int(share * count) for share in _STRANGE})


def _other(sessions: Mapping[str, Sequence[Case]], name: str) -> Sequence[Case]:
    """Return the next session, of the same level if there is one."""
    names = list(sessions)
    after = names[names.index(name) + 1 :] + names[: names.index(name)]
    alike = [one for one in after if sessions[one][0].level == sessions[name][0].level]
    return sessions[(alike or after or [name])[0]]


def false_trials(honest: Sequence[Trial], runs: Sequence[Run]) -> list[Trial]:
    """Make the trials: each honest one falsified in every way, with the ``runs`` of the false cases."""
    anew = {(run.case.session, run.case.kind, run.case.frame): run for run in runs}
    trials = []
    for i, one in enumerate(honest):

        def of_kind(kind: str, own: Trial = one) -> list[Run]:
            return [anew.get((own.session, kind, run.case.frame), run) for run in own.runs]

        other = next((t for t in [*honest[i + 1 :], *honest[:i]] if t.level == one.level), one)
        half = len(one.runs) // 2
        late = of_kind(LATE)[_LATE_BY:]
        trials += [
            replace(one, kind=STRANGERS, runs=of_kind(STRANGERS)),
            replace(one, kind=LATE, runs=late),
            replace(one, kind=MOVED, runs=[*one.runs[:half], *other.runs[half:]]),
            replace(one, kind=ARM, arm="si"),
        ]
    return trials


def _names_strangers(outcome: Outcome, found: SessionCalibration) -> bool:
    return list(found.left_out) == [f"{k:04d}" for k in _strange(len(outcome.trial.runs))]


def _names_lag(outcome: Outcome, found: SessionCalibration) -> bool:
    return found.lag is not None and found.lag["frames"] == _LATE_BY


def _names_move(outcome: Outcome, found: SessionCalibration) -> bool:
    half = len(outcome.trial.runs) // 2
    return any(f"moved between frames {half - 1:04d} and {half:04d}" in text for text in found.warnings)


_NAMES: Final[dict[str, Callable[[Outcome, SessionCalibration], bool]]] = {
    STRANGERS: _names_strangers,
    LATE: _names_lag,
    MOVED: _names_move,
}


def named(outcome: Outcome) -> bool:
    """Whether the lie was named for what it is."""
    if outcome.solved is None:
        return outcome.trial.kind == ARM and "51 mm" in outcome.refusal
    check = _NAMES.get(outcome.trial.kind)
    return check is not None and check(outcome, outcome.solved.calibration)


def lie_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """One row a false session: whether the lie was named, what was said, and errors of the base that was still found.

    Of a base that moved half way, the first one's error is given, which need not be the one that was kept.
    """
    rows = []
    for outcome in outcomes:
        row: dict[str, Any] = {"session": outcome.trial.session, "kind": outcome.trial.kind, "named": named(outcome)}
        if outcome.solved is None:
            row["said"] = outcome.refusal
        else:
            calibration = outcome.solved.calibration
            row["base_deg"], row["base_mm"] = base_error(outcome)
            row["said"] = "; ".join(calibration.warnings) or "left out: " + (" ".join(calibration.left_out) or "none")
        rows.append(row)
    return rows


def lie_report(outcomes: Sequence[Outcome]) -> dict[str, list[dict[str, Any]]]:
    """Count by kind how many false sessions were named for what they are; then each of them."""
    rows = lie_rows(outcomes)
    kinds = dict.fromkeys(row["kind"] for row in rows)
    counts = []
    for kind in kinds:
        own = [row for row in rows if row["kind"] == kind]
        errors = [row["base_deg"] for row in own if "base_deg" in row]
        origins = [row["base_mm"] for row in own if "base_mm" in row]
        one: dict[str, Any] = {"kind": kind, "sessions": len(own), "named": sum(row["named"] for row in own) / len(own)}
        if kind in (STRANGERS, LATE) and errors:
            one |= {"worst_base_deg": max(errors), "worst_base_mm": max(origins)}
        counts.append(one)
    return {"lies named": counts, "sessions": rows}
