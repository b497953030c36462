"""Falsified sessions, whose calibration should report the falsification.

Each kind of falsification changes one property of a session with known truth: three masks are those of another session,
the readings are two frames late, the base moves in the middle of the session, or the arm is the wrong one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.silhouette import Body
from measure.accuracy.mistakes import mistake_row, mistaken_cases
from measure.accuracy.sessions import Outcome, Trial, base_error, original_trials, solve
from measure.cases import Case, Measurement, Run, grouped

FOREIGN_MASKS: Final = "3 masks of another session"
LATE: Final = "readings 2 frames late"
MOVED: Final = "base moved half way"
WRONG_ARM: Final = "wrong arm"

_LATE_BY: Final = 2
_FOREIGN_SHARES: Final = (0.1, 0.5, 0.8)  # positions of the foreign masks, as shares of the number of frames


def measure_session_lies(given: Measurement, other: Body | None = None) -> dict[str, list[dict[str, Any]]]:
    """Report the share of falsified sessions that are reported as such, and what happens with users' mistakes."""
    cases = given.cases(base=True)
    falsified = falsified_session_cases(grouped(cases, lambda case: case.session))
    mistaken = mistaken_cases(cases, other)
    runs = given.runs([*cases, *falsified, *mistaken], "frames and lies")
    originals = original_trials(runs[: len(cases)])
    until = len(cases) + len(falsified)
    report = falsified_report(solve(given, falsified_trials(originals, runs[len(cases) : until])))
    return {**report, "mistakes": _with_mistakes(given, runs[until:])}


def _with_mistakes(given: Measurement, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Calibrate each session with each mistake, and report by kind what happens to its frames."""
    rows, kinds = [], grouped(runs, lambda run: run.case.kind)
    trials = [trial for own in kinds.values() for trial in original_trials(own)]
    for kind, outcomes in grouped(solve(given, trials), lambda outcome: outcome.trial.kind).items():
        solved = [(one.trial, one.solved) for one in outcomes if one.solved is not None]
        pairs = [
            (result, run.case)
            for trial, session in solved
            for result, run in zip(session.results.values(), trial.runs, strict=True)
        ]
        row = mistake_row(given.body.instrument, kind, pairs)
        doubts = dict.fromkeys(text.split(":")[0] for _, session in solved for text in session.calibration.doubts)
        rows.append({**row, "refused": len(outcomes) - len(solved), "doubts": "; ".join(doubts) or "-"})
    return rows


def falsified_session_cases(sessions: Mapping[str, Sequence[Case]]) -> list[Case]:
    """Make the falsified frames that have to be estimated: those with foreign masks, and those with late readings."""
    made = []
    for name, cases in sessions.items():
        other = _other(sessions, name)
        for k in _foreign_frames(len(cases)):
            foreign = other[k % len(other)]
            data = FrameData.of(foreign.mask, cases[k].camera, foreign.ignore)
            made.append(replace(cases[k], kind=FOREIGN_MASKS, data=data, truth=None))
        for k in range(_LATE_BY, len(cases)):
            made.append(replace(cases[k], kind=LATE, readings=cases[k - _LATE_BY].readings))
    return made


def _foreign_frames(count: int) -> list[int]:
    """Return the indices of the frames with foreign masks in a session of ``count`` frames."""
    return sorted({int(share * count) for share in _FOREIGN_SHARES})


def _other(sessions: Mapping[str, Sequence[Case]], name: str) -> Sequence[Case]:
    """Return the cases of the next session, of the same level if there is one."""
    names = list(sessions)
    after = names[names.index(name) + 1 :] + names[: names.index(name)]
    same_level = [one for one in after if sessions[one][0].level == sessions[name][0].level]
    return sessions[(same_level or after or [name])[0]]


def falsified_trials(originals: Sequence[Trial], runs: Sequence[Run]) -> list[Trial]:
    """Make a trial of each original one and each kind of falsification, with the ``runs`` of the falsified cases."""
    falsified = {(run.case.session, run.case.kind, run.case.frame): run for run in runs}
    trials = []
    for i, one in enumerate(originals):

        def of_kind(kind: str, own: Trial = one) -> list[Run]:
            return [falsified.get((own.session, kind, run.case.frame), run) for run in own.runs]

        other = next((t for t in [*originals[i + 1 :], *originals[:i]] if t.level == one.level), one)
        half = len(one.runs) // 2
        late = of_kind(LATE)[_LATE_BY:]
        trials += [
            replace(one, kind=FOREIGN_MASKS, runs=of_kind(FOREIGN_MASKS)),
            replace(one, kind=LATE, runs=late),
            replace(one, kind=MOVED, runs=[*one.runs[:half], *other.runs[half:]]),
            replace(one, kind=WRONG_ARM, arm="si"),
        ]
    return trials


def named(outcome: Outcome) -> bool:
    """Whether the calibration reported the falsification correctly.

    It leaves out exactly the frames with foreign masks, finds the lag, states between which frames the base moved, or
    refuses the readings of the wrong arm.
    """
    if outcome.solved is None:
        return outcome.trial.kind == WRONG_ARM and "51 mm" in outcome.refusal
    found, count = outcome.solved.calibration, len(outcome.trial.runs)
    moved = f"moved between frames {count // 2 - 1:04d} and {count // 2:04d}"
    said = {
        FOREIGN_MASKS: list(found.left_out) == [f"{k:04d}" for k in _foreign_frames(count)],
        LATE: found.lag is not None and abs(found.lag.in_unit("frames") + _LATE_BY) < 0.5,
        MOVED: any(moved in text for text in found.remarks),
    }
    return said.get(outcome.trial.kind, False)


def falsified_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return one row for each falsified session: whether the falsification was reported, the messages, base errors.

    If the base moved, the errors are relative to its first pose, which is not always the one that was calibrated.
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


def falsified_report(outcomes: Sequence[Outcome]) -> dict[str, list[dict[str, Any]]]:
    """Return the share of correctly reported falsifications by kind, and the rows of all falsified sessions."""
    rows = falsified_rows(outcomes)
    kinds = dict.fromkeys(row["kind"] for row in rows)
    counts = []
    for kind in kinds:
        own = [row for row in rows if row["kind"] == kind]
        errors = [row["base_deg"] for row in own if "base_deg" in row]
        origins = [row["base_mm"] for row in own if "base_mm" in row]
        one: dict[str, Any] = {"kind": kind, "sessions": len(own), "named": sum(row["named"] for row in own) / len(own)}
        if kind in (FOREIGN_MASKS, LATE) and errors:
            one |= {"worst_base_deg": max(errors), "worst_base_mm": max(origins)}
        counts.append(one)
    return {"lies named": counts, "sessions": rows}
