"""Many recordings with known truth, each followed with its own calibration: a row of figures for each, and one for all.

Errors are those of the tips in frames in which at least half of the jaws can be seen (``visible`` in golden.json); a
frame without a pose counts as a metre off. The share of ok frames is that of frames of which 0.8 of the jaws are seen.
A recording is wrong if more than a fifth of its ok frames are more than 3 mm off.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.results.track_files import TRACKS, read_tracks
from dvrk_cmaes.runs.track_folder import track_folder
from dvrk_cmaes.runs.track_frames import TrackSettings, used_session
from measure.accuracy.endoscope import endoscope_figures, without_ecm
from measure.accuracy.figures import base_errors
from measure.accuracy.fleet_calibrations import (
    MOST_STD,
    base_in_std,
    calibrated,
    names_focal_length,
    pooled,
    wrong_focal_length,
)
from measure.accuracy.tip_probability import reliability_rows
from measure.cases import Measurement

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

_VISIBLE, _IN_VIEW = 0.5, 0.8
_WITHOUT_POSE_MM: Final = 1000.0
_WRONG_MM: Final = (2.0, 3.0)
_WRONG_SHARE: Final = 0.2


@dataclass(frozen=True, eq=False)
class TipErrors:
    """Frames of a recording in which the jaws are seen: errors of the tips, mm, and their stated standard deviations.

    ``ok`` tells the status, ``in_view`` whether nearly all of the jaws is seen. ``stated`` is the stated probability
    that the tips are near. All are (F,); ``std`` and ``stated`` are NaN where nothing is stated.
    """

    errors: Float64
    std: Float64
    ok: Bool
    in_view: Bool
    stated: Float64

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, Any]], golden: Mapping[str, Any]) -> TipErrors:
        """Compare rows of tracks.jsonl with the truth, the frames of golden.json by name."""
        table = []
        for row in rows:
            truth = golden[row["frame"]]
            visible = truth.get("visible", 1.0)
            if visible < _VISIBLE:
                continue
            error, stated, probability = _WITHOUT_POSE_MM, np.nan, row.get("tip_probability")
            if row["tips"] is not None:
                off = np.array(row["tips"]) - np.array(truth["tips_camera_m"])
                error, stated = 1e3 * float(np.linalg.norm(off, axis=1).mean()), float(row["std"]["tip_mm"])
            near = np.nan if probability is None else probability
            table.append((error, stated, row["status"] == "ok", visible >= _IN_VIEW, near))
        errors, std, ok, in_view, probabilities = np.array(table, dtype=np.float64).reshape(-1, 5).T
        return cls(errors, std, ok > 0, in_view > 0, probabilities)

    @classmethod
    def pooled(cls, each: Sequence[TipErrors]) -> TipErrors:
        """Put the frames of several recordings together."""
        names = ("errors", "std", "ok", "in_view", "stated")
        return cls(*(np.concatenate([getattr(one, name) for one in each]) for name in names))

    def reliability(self, within_mm: float) -> list[dict[str, Any]]:
        """Return by stated probability how many frames there are, and what share of them is within a distance."""
        told = ~np.isnan(self.stated)
        return reliability_rows(self.stated[told], self.errors[told] < within_mm)

    @property
    def wrong(self) -> bool:
        """Whether the recording is wrong: many of its ok frames are far off."""
        return _share(self.errors[self.ok] > _WRONG_MM[-1]) > _WRONG_SHARE

    def figures(self) -> dict[str, Any]:
        """Return the figures of a row."""
        median, most, worst = _percentiles(self.errors, 50, 95, 100)
        ratio = (self.errors / self.std)[~np.isnan(self.std)]
        usual, large = _percentiles(ratio, 50, 95)
        trusted = self.errors[self.ok]
        return {
            "frames": len(self.errors),
            "tips, mm": median,
            "95 %": most,
            "worst": worst,
            "ok in view": _share(self.ok[self.in_view]),
            **{f"ok beyond {limit:g} mm": _share(trusted > limit) for limit in _WRONG_MM},
            "error / std": usual,
            "error / std, 95 %": large,
        }


def _percentiles(values: Float64, *shares: float) -> list[float]:
    """Return percentiles of values (F,); NaN without any."""
    return np.percentile(values, shares).tolist() if len(values) else [float("nan")] * len(shares)


def _share(which: Bool) -> float:
    """Return the share of values (F,) that are true; NaN without any."""
    return float(which.mean()) if len(which) else float("nan")


def fleet_report(
    given: Measurement,
    *,
    causal: bool = False,
    keep: Path | None = None,
    every: int | None = None,
    first: int = 0,
    wrong_focal: int | None = None,
    ecm: bool = True,
) -> dict[str, Any]:
    """Follow all recordings, and return a row of figures for each and one for all; results go to ``keep`` if given.

    With ``every``, every N-th frame of each is calibrated as well, which makes two more tables. With ``first``,
    figures are of the frames from that one on, and two more tables of those before it, and of their second half. With
    ``wrong_focal``, every N-th frame is calibrated with a focal length that is 10 % too long, or too short, too.
    Without ``ecm``, the readings of the endoscope's arm are not used.
    """
    calibrations: dict[str, Any] = {}
    if every is not None:
        each = []
        for folder in recordings_in(given.folders):
            golden = json.loads((folder / "golden.json").read_text(encoding="utf-8"))
            session = read_session(folder)
            each.append(calibrated(folder.name, session, golden, given.body, given.config, given.workers, every))
        calibrations = {"calibrated": [one.row for one in each], "all calibrated": [pooled(each)]}
    return calibrations | _followed(given, causal=causal, keep=keep, first=first, wrong_focal=wrong_focal, ecm=ecm)


def _followed(
    given: Measurement, *, causal: bool, keep: Path | None, first: int, wrong_focal: int | None, ecm: bool
) -> dict[str, Any]:
    """Follow all recordings, and return a row of figures for each and one for all."""
    rows: list[dict[str, Any]] = []
    found: list[TipErrors] = []
    early: list[TipErrors] = []
    later: list[TipErrors] = []
    with tempfile.TemporaryDirectory() as temporary:
        for folder in recordings_in(given.folders):
            print(f"{folder.name}: following", file=sys.stderr, flush=True)
            golden = json.loads((folder / "golden.json").read_text(encoding="utf-8"))
            out = (Path(temporary) if keep is None else keep) / folder.name
            read = folder if ecm else without_ecm(folder, Path(temporary) / "without")
            session, evidence = used_session(read_session(read), None)
            settings = TrackSettings(given.config, causal=causal, evidence=evidence, workers=given.workers)
            done = track_folder(session, out, given.body, settings, video=False, page=False, notice=_notice)
            tracked = read_tracks(out / TRACKS)
            found.append(TipErrors.of(tracked[first:], golden["frames"]))
            early.append(TipErrors.of(tracked[:first], golden["frames"]))
            later.append(TipErrors.of(tracked[first // 2 : first], golden["frames"]))
            row = {"recording": folder.name, **found[-1].figures(), "wrong": found[-1].wrong}
            row |= _of_calibration(done.calibration, golden)
            if wrong_focal is not None:
                of_session = session, given.body, given.config, given.workers, wrong_focal
                row["wrong focal length named"] = wrong_focal_length(*of_session, longer=len(rows) % 2 == 1)
            if "endoscope" in golden:
                row |= endoscope_figures(done.calibration, golden)
            rows.append(row)
    of_all, right = TipErrors.pooled(found), [one for one in found if not one.wrong]
    total = {"recordings": len(rows), **of_all.figures(), "worst median": max(row["tips, mm"] for row in rows)}
    total["wrong"] = len(found) - len(right)
    if right:
        pooled_right = TipErrors.pooled(right)
        total["ok in view, right ones"] = _share(pooled_right.ok[pooled_right.in_view])
    total[f"base within {MOST_STD:g} std"] = sum((row["base / std"] or np.inf) <= MOST_STD for row in rows)
    for name in ("camera contradicted", "focal length named"):
        total[name] = sum(bool(row[name]) for row in rows)
    if wrong_focal is not None:
        total["wrong focal length named"] = sum(row["wrong focal length named"] is True for row in rows)
    report: dict[str, Any] = {"recordings": rows, "all": [total]}
    report["stated probability and share near the truth"] = of_all.reliability(given.config.trust.tip_mm)
    if first:
        report[f"before frame {first}"] = [TipErrors.pooled(early).figures()]
        report[f"from frame {first // 2} to {first}"] = [TipErrors.pooled(later).figures()]
    return report


def _of_calibration(found: SessionCalibration | None, golden: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a recording's calibration; None where there is none, or no truth."""
    row: dict[str, Any] = {"base, deg": None, "base, mm": None, "base / std": None, "camera contradicted": None}
    row |= {"focal length named": None, "lag": None, "doubts": None}
    if found is None:
        return row
    if golden.get("camera_from_base") is not None:
        true = np.array(golden["camera_from_base"])
        row["base, deg"], row["base, mm"] = base_errors(found.camera_from_base, true)
        row["base / std"] = base_in_std(found, true)
    row["camera contradicted"] = found.camera is not None and found.camera.contradicts
    row["focal length named"] = names_focal_length(found)
    row["lag"] = None if found.lag is None else found.lag.frames
    return row | {"doubts": len(found.doubts)}


def recordings_in(folders: Sequence[str | Path]) -> Iterator[Path]:
    """Give the recordings with a truth among folders, or in them."""
    for folder in map(Path, folders):
        if (folder / "golden.json").exists():
            yield folder
        else:
            yield from sorted(path.parent for path in folder.glob("*/golden.json"))


def _notice(text: str) -> None:
    """Print a line about a recording."""
    print(f"  {text}", file=sys.stderr, flush=True)
