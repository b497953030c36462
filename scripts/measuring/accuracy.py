"""Commands on session folders against the truth: errors, what is stated of them, calibrations, speed; and falsified."""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.io.json_file import write_json
from measuring.falsified import FALSIFIED, INPUTS, falsified
from measuring.report import ROOT, Report, commit, in_processes, machine, today
from measuring.runner import Command, Failure, goldens, sessions_in, solved
from measuring.scorer import (
    Scored,
    arms_figures,
    calibration_figures,
    figures,
    fitted_probability,
    is_wrong,
    reason_rows,
    reliability,
    scored,
    stated_figures,
    total_of_calibrations,
)

FIGURES: Final = ROOT / "data" / "figures.json"


@dataclass(frozen=True)
class Measured:
    """A session folder that was solved, or an arm of it: frames against the truth, the calibration, seconds a frame.

    ``documents`` has the statuses of all frames, of a session without truth as well.
    """

    name: str
    kind: str
    frames: tuple[Scored, ...]
    documents: Mapping[str, Mapping[str, Any]]
    calibration: dict[str, Any] | None
    arms: tuple[dict[str, Any], ...]
    failures: tuple[Failure, ...]
    processor: float

    @property
    def level(self) -> str:
        """The name up to its first digit."""
        return re.split(r"\d", self.name)[0] or self.name

    def row(self) -> dict[str, Any]:
        """Return its figures."""
        said = {"session": self.name} | ({"falsified": self.kind} if self.kind else {})
        count = max(len(self.documents), 1)
        counts = {} if self.frames else _counts(self.documents)
        own = figures(self.frames) | {"wrong": is_wrong(self.frames)} if self.frames else counts
        failed = {"failed": self.failures[0].error} if self.failures else {}
        return said | own | (self.calibration or {}) | {"processor s a frame": self.processor / count} | failed


def _counts(documents: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the figures of frames without truth."""
    overlaps = [own["quality"]["iou"] for own in documents.values() if own.get("quality")]
    ok = sum(own["status"] == "ok" for own in documents.values())
    return {"frames": len(documents), "ok": ok, "IoU": sum(overlaps) / len(overlaps) if overlaps else None}


def measure_folder(
    folder: Path, name: str, command: Command, out: Path, options: Sequence[str], source: str, kind: str = ""
) -> list[Measured]:
    """Solve a folder and compare it with the truth; of several arms one is returned for each."""
    ran = solved(folder, command, out, [*options, "--instrument", source])
    truths, instrument = goldens(folder), load_instrument(source)
    focal = read_session(folder).rig.camera.fx
    found: list[Measured] = []
    arms = ran.document("arms.json")
    for arm, golden in (truths or {None: {"frames": {}}}).items():
        documents, session = ran.documents(arm), ran.document("session.json", arm)
        frames = tuple(_scored(instrument, documents, golden, focal, whole=command == "track"))
        calibration = calibration_figures(session, golden) if command != "estimate" else None
        of_arms = tuple(arms_figures(arms, {str(a): own for a, own in truths.items()})) if arms and not found else ()
        share = ran.processor / max(len(truths), 1)
        of_arm = name if arm is None else f"{name} {arm}"
        found.append(Measured(of_arm, kind, frames, documents, calibration, of_arms, ran.failures, share))
    return found


def _scored(
    instrument: Instrument, documents: Mapping[str, Any], golden: Mapping[str, Any], focal: float, *, whole: bool
) -> list[Scored]:
    """Score the frames that a command answered; of a recording, all."""
    asked = {name: truth for name, truth in golden["frames"].items() if whole or name in documents}
    return [*scored(instrument, documents, asked, focal)]


def accuracy_report(options: argparse.Namespace) -> Report:
    """Solve all session folders among or in those given, also falsified if asked for, and return tables."""
    groups, command = {"all": FALSIFIED, "inputs": INPUTS}, options.command
    kinds = [*dict.fromkeys(kind for name in options.falsify or [] for kind in groups.get(name, [name]))]
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary) if options.keep is None else options.keep
        sessions = [*sessions_in(options.folders)]
        several = Counter(folder.resolve().name for folder in sessions)
        names = {
            one: "/".join(one.resolve().parts[-2 if several[one.resolve().name] > 1 else -1 :]) for one in sessions
        }
        tasks: list[tuple[Any, ...]] = []
        for number, folder in enumerate(sessions):
            for kind in ("", *kinds):
                out = place / command / (kind.replace(" ", "_") or "true") / names[folder]
                after = sessions[(number + 1) % len(sessions)]
                given = (options.further, options.instrument, kind)
                tasks.append((folder, names[folder], after, command, out, *given))
        found = [one for each in in_processes(_one, tasks, options.workers, "folders") for one in each]
    report: dict[str, list[Mapping[str, Any]]] = {"sessions": [one.row() for one in found]}
    true = [one for one in found if not one.kind]
    frames = [frame for one in true for frame in one.frames]
    if kinds:
        report["falsified"] = [_of_kind(kind or "true", [o for o in found if o.kind == kind]) for kind in ("", *kinds)]
        report["falsified"] += [_of_kind("all falsified", [one for one in found if one.kind])]
    if frames:
        levels = dict.fromkeys(one.level for one in true)
        of_level = {name: [f for one in true if one.level == name for f in one.frames] for name in levels}
        report["levels"] = [{"level": n, **figures(own)} for n, own in of_level.items()]
        report["all"] = [{"wrong": sum(is_wrong(one.frames) for one in true), **figures(frames)}]
        report["stated probability of tips within 2 mm, and share of these"] = [*reliability(frames)]
    if command != "estimate":
        report["all calibrations"] = [total_of_calibrations([one.calibration or {} for one in true])]
    if arms := [{"session": one.name, **row} for one in true for row in one.arms]:
        report["bases of arms in that of their reference"] = [*arms]
    report["reasons"] = [*reason_rows(frames)] if frames else []
    if options.table:
        report["frames"] = [{"session": one.name, **_frame_row(f)} for one in found for f in one.frames]
    if options.fit:
        report["constants that fit these frames"] = [*fitted_probability(frames)]
    if options.set is not None:
        _write_figures(options.set, report)
    return report


def _one(
    folder: Path, name: str, other: Path, command: Command, out: Path, options: Sequence[str], source: str, kind: str
) -> list[Measured]:
    """Solve a folder in a worker process, after it was falsified if there is a ``kind``."""
    if not kind:
        return measure_folder(folder, name, command, out, options, source)
    made = falsified(folder, other, kind, out.with_name(f"{out.name}-inputs"), load_instrument(source))
    return (
        [] if made is None else measure_folder(made.folder, name, command, out, [*options, *made.options], source, kind)
    )


def _of_kind(kind: str, found: Sequence[Measured]) -> dict[str, Any]:
    """Return how many frames of a kind are ok, ok and wrong, doubted, and have a remark or a doubt of the session."""
    frames = [frame for one in found for frame in one.frames]
    documents = [own for one in found for own in one.documents.values()]
    remarked = [bool(own.get("remarks")) or any("session: " in text for text in own["reasons"]) for own in documents]
    doubts = dict.fromkeys(str(one.calibration["doubts"]) for one in found if one.calibration)
    reasons = ", ".join(f"{row['reason']} {row['share']:.2f}" for row in reason_rows(frames)[:3]) if frames else "-"
    return {
        "falsified": kind,
        "frames": len(frames),
        "ok and wrong": sum(frame.wrong for frame in frames),
        **stated_figures(frames),
        "remarked": sum(remarked),
        "refused": sum(bool(one.failures) for one in found),
        "session's doubts": " | ".join(doubts) or "-",
        "reasons": reasons or "-",
    }


def _frame_row(frame: Scored) -> dict[str, Any]:
    """Return the row of a frame."""
    said = {"frame": frame.frame, "status": frame.status, "right mode": frame.right_mode, "tips, mm": frame.error_mm}
    rest = {"std, mm": frame.std_mm, "shaft, deg": frame.shaft_deg, "IoU": frame.iou}
    return said | rest | {"reasons": "; ".join(text.split(":")[0] for text in frame.reasons) or "-"}


def _write_figures(name: str, report: Report) -> None:
    """Replace a set of data/figures.json, whose tables are in README and the page on accuracy, by the levels."""
    document = json.loads(FIGURES.read_text(encoding="utf-8"))
    rows = {
        row["session"].removeprefix("made/"): {
            "frames": row["frames"],
            "ok": row["ok"],
            **({"right_mode": row["right mode"]} if "right mode" in row else {}),
            **{key: row[of] for key, of in _OF_FIGURES.items() if row.get(of) is not None},
        }
        for row in report["sessions"]
    }
    stated = {"date": today(), "machine": machine(), "commit": commit()}
    document["frames"][name] = {**stated, "rows": {**document["frames"].get(name, {}).get("rows", {}), **rows}}
    write_json(FIGURES, document)


_OF_FIGURES: Final = {"tip_mm": "tips, mm", "axis_deg": "shaft, deg", "joint_deg": "worst joint, deg", "iou": "IoU"}
