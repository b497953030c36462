"""The one scorer: results of any command or method against the truth, and the figures of many of them.

The error of a frame is the mean distance of the ends of the instrument (of the jaws' tips) from where they are. Nothing
is forgiven: the mirror twin is an error, and so are exchanged jaws. A frame without a pose is a metre off. It is ok and
wrong if its status is ok and the error is more than 3 mm and 2 px, whatever standard deviation it states. A recording
or session is wrong if more than a fifth of its ok frames are off by more than 3 mm. Frames in which less than half of
the ends is seen (``visible`` in golden.json) do not count.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import chi2, norm

from dvrk_cmaes.evaluate.pose_error import compare_rotations
from dvrk_cmaes.geometry import apply, change_between, inverse, rotation_angle
from dvrk_cmaes.instrument import Instrument

Float64 = NDArray[np.float64]
Document = Mapping[str, Any]

RIGHT_MODE_DEG: Final = 30.0
"""Largest rotation error of a pose in the right mode."""
WRONG_MM: Final = 3.0
WITHOUT_POSE_MM: Final = 1000.0
NEAR_MM: Final = 2.0
"""Error within which tips are near, for the stated probability of it."""
_WRONG_PX: Final = 2.0
_WRONG_SHARE: Final = 0.2
_LEAST_SEEN: Final = 0.5
_INTERVAL: Final = 0.9
_MOST_STD: Final = 3.0


@dataclass(frozen=True, eq=False)
class Scored:
    """A frame: its status, errors, and what it states of these; None where nothing is stated or there is no pose.

    error_mm, rotation_deg, shaft_deg, joints_deg (of each joint) : errors. limit_mm : the error from which on an
    ok frame is wrong. std_mm, range_mm : stated standard deviation of the error, and its 90 % range. ratios (6 + J,) :
    errors along and about the root's axes and of the joints, in stated standard deviations. square : squared error in
    the stated covariance, and degrees of freedom. tip_probability, mode_probability, iou, seconds, reasons : as in the
    result.
    """

    frame: str
    status: str
    error_mm: float
    limit_mm: float
    rotation_deg: float = 180.0
    shaft_deg: float | None = None
    joints_deg: Float64 | None = None
    std_mm: float | None = None
    range_mm: float | None = None
    ratios: Float64 | None = None
    square: tuple[float, int] | None = None
    tip_probability: float | None = None
    mode_probability: float | None = None
    iou: float | None = None
    seconds: float | None = None
    reasons: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the status is ok."""
        return self.status == "ok"

    @property
    def right_mode(self) -> bool:
        """Whether the pose is in the right mode."""
        return self.rotation_deg < RIGHT_MODE_DEG

    @property
    def wrong(self) -> bool:
        """Whether the status is ok, but the error is too large."""
        return self.ok and self.error_mm > self.limit_mm

    @property
    def misstated(self) -> bool:
        """Whether the status is ok, but the error is beyond 3 mm, or beyond 2 mm and 3 stated standard deviations."""
        stated = _MOST_STD * (np.inf if self.std_mm is None else self.std_mm)
        return self.ok and self.error_mm > min(WRONG_MM, max(NEAR_MM, stated))


def scored(
    instrument: Instrument, documents: Mapping[str, Document], golden: Mapping[str, Document], focal_px: float
) -> Iterator[Scored]:
    """Compare results by frame, as in frames/FRAME.json or rows of tracks.jsonl, with the frames of golden.json."""
    for name, truth in golden.items():
        if truth.get("visible", 1.0) < _LEAST_SEEN:
            continue
        ends = np.array(truth["tips_camera_m"])
        limit = max(WRONG_MM, _WRONG_PX * 1e3 * float(ends[:, 2].mean()) / focal_px)
        found = documents.get(name, {})
        if found.get("camera_from_root") is None:
            reasons = tuple(found.get("reasons", ("no result",)))
            yield Scored(name, found.get("status", "failed"), WITHOUT_POSE_MM, limit, reasons=reasons)
            continue
        pose, true = np.array(found["camera_from_root"]), np.array(truth["T_camera_roll_link"])
        joints = np.array([found["joints"][joint] for joint in instrument.joint_names])
        off = np.array([truth["joints"][joint] for joint in instrument.joint_names]) - joints
        ratios, square = _in_std(np.append(change_between(pose, true), off), found)
        yield Scored(
            name,
            found["status"],
            1e3 * float(np.linalg.norm(apply(pose, instrument.ends(joints)) - ends, axis=1).mean()),
            limit,
            float(np.degrees(rotation_angle(pose, true))),
            compare_rotations(pose, true).shaft_deg,
            np.degrees(np.abs(off)),
            _stated_mm(found.get("std")),
            (found.get("std") or {}).get("tip_90_mm"),
            ratios,
            square,
            found.get("tip_probability"),
            found.get("mode_probability"),
            (found.get("quality") or {}).get("iou"),
            found.get("seconds"),
            tuple(found.get("reasons", ())),
        )


def score_base(document: Document | None, true: Float64) -> tuple[Scored, Float64]:
    """Compare a base with the truth (4, 4); return it as a frame, and its errors (6,) in standard deviations or NaN."""
    if document is None:
        return Scored("base", "failed", WITHOUT_POSE_MM, WRONG_MM), np.full(6, np.nan)
    pose = np.array(document["camera_from_base"])
    turned, off = compare_rotations(pose, true), change_between(pose, true)
    ratios, square = _in_std(off, document)
    limit = WRONG_MM if turned.rotation_deg <= NEAR_MM else -1.0  # deg: as many as mm of tips
    moved = 1e3 * float(np.linalg.norm(pose[:3, 3] - true[:3, 3]))
    of = (document["status"], moved, limit, turned.rotation_deg, turned.shaft_deg)
    found = Scored("base", *of, ratios=ratios, square=square, seconds=document.get("seconds"))
    return found, np.full(6, np.nan) if ratios is None else ratios


def _in_std(error: Float64, document: Document) -> tuple[Float64 | None, tuple[float, int] | None]:
    """Return an error (N,) in the standard deviations that a document states, and squared in its covariance."""
    covariance, std = document.get("covariance"), document.get("std")
    if covariance:
        matrix = np.array(covariance["matrix"])[: len(error), : len(error)]
        square = float(error @ np.linalg.solve(matrix, error)), len(error)
        return error / np.sqrt(np.diag(matrix)), square
    if not std or "translation_mm" not in std:
        return None, None
    turns = [*std["rotation_deg"], *std["joints_deg"].values()]
    return error / np.array([*(1e-3 * np.array(std["translation_mm"])), *np.deg2rad(turns)]), None


def _stated_mm(std: Document | None) -> float | None:
    """Return the stated standard deviation of the ends' middle, mm, of a result or of a row of tracks.jsonl.

    Of an instrument without a pair of jaws it is that of the position.
    """
    if not std:
        return None
    ends = std.get("tip_mm")
    if isinstance(ends, Mapping):
        return float(ends["mean" if "mean" in ends else "tip"])
    return float(np.linalg.norm(std["translation_mm"])) if ends is None else float(ends)


def stated_figures(frames: Sequence[Scored]) -> dict[str, Any]:
    """Return how true is what frames state: those that are ok and misstated, shares outside ranges, tips near."""
    outside = [frame.error_mm > frame.range_mm for frame in frames if frame.ok and frame.range_mm is not None]
    sure = [frame.error_mm < NEAR_MM for frame in frames if (frame.tip_probability or 0.0) > _INTERVAL]
    return {
        "ok": sum(frame.ok for frame in frames),
        "ok and misstated": sum(frame.misstated for frame in frames),
        "worst ok": max((frame.error_mm for frame in frames if frame.ok), default=None),
        "outside 90 %": _mean(outside),
        "probability > .9": len(sure),
        "near": _mean(sure),
    }


def is_wrong(frames: Sequence[Scored]) -> bool:
    """Return whether a recording or session is wrong: many of its ok frames are far off."""
    far = [frame.error_mm > WRONG_MM for frame in frames if frame.ok]
    return bool(far) and float(np.mean(far)) > _WRONG_SHARE


def figures(frames: Sequence[Scored]) -> dict[str, Any]:
    """Return the figures of many frames: a row of a table."""
    errors, ok = [frame.error_mm for frame in frames], [frame for frame in frames if frame.ok]
    ratios = [frame.error_mm / frame.std_mm for frame in frames if frame.std_mm]
    return {
        "frames": len(frames),
        "right mode": sum(frame.right_mode for frame in frames),
        "ok": len(ok),
        "ok and wrong": sum(frame.wrong for frame in frames),
        **dict(zip(("tips, mm", "95 %", "worst"), _percentiles(errors, 50, 95, 100), strict=True)),
        "worst ok": max((frame.error_mm for frame in ok), default=None),
        "shaft, deg": _median(frame.shaft_deg for frame in frames),
        "joints, deg": _median(f.joints_deg.mean() for f in frames if f.joints_deg is not None),
        "worst joint, deg": _median(f.joints_deg.max() for f in frames if f.joints_deg is not None),
        "IoU": None if not (known := [f.iou for f in frames if f.iou is not None]) else float(np.mean(known)),
        "error / std": _percentiles(ratios, 50)[0],
        "90 % intervals": coverage(ok, _INTERVAL),
        "90 % regions": _mean([f.square[0] <= chi2.ppf(_INTERVAL, f.square[1]) for f in ok if f.square]),
        "s a frame": _median(frame.seconds for frame in frames),
    }


def coverage(frames: Sequence[Scored], level: float) -> float | None:
    """Return the share of the stated intervals of a probability that contain the truth; None without any."""
    ratios = [frame.ratios for frame in frames if frame.ratios is not None]
    return float(np.mean(np.abs(np.concatenate(ratios)) <= norm.ppf((1 + level) / 2))) if ratios else None


def reliability(frames: Sequence[Scored]) -> list[dict[str, Any]]:
    """Return in ten bins of the stated probability that the tips are near how many are, and their share."""
    known = [(f.tip_probability, f.error_mm < NEAR_MM) for f in frames if f.tip_probability is not None]
    bins: dict[int, list[tuple[float, bool]]] = {}
    for stated, near in known:
        bins.setdefault(min(int(10 * stated), 9), []).append((stated, near))
    return [
        {"stated": f"{k / 10:g} to {(k + 1) / 10:g}", "frames": len(own)}
        | dict(zip(("mean stated", "near"), np.mean(own, axis=0).tolist(), strict=True))
        for k, own in sorted(bins.items())
    ]


def fitted_probability(frames: Sequence[Scored]) -> list[dict[str, float]]:
    """Return the constants of `dvrk_cmaes.pose.expected_error` for which the outcomes of frames are most likely."""
    known = [f for f in frames if f.std_mm and f.error_mm < WITHOUT_POSE_MM]
    doubt = np.array([max(1 - (1.0 if f.mode_probability is None else f.mode_probability), 1e-4) for f in known])
    sharp = np.log(NEAR_MM / np.array([f.std_mm for f in known]))
    near = np.array([f.error_mm < NEAR_MM for f in known])

    def cost(constants: Float64) -> float:
        a, b, c, d = constants
        p = np.clip(expit(a - b * np.log(doubt)) * expit(c + d * sharp), 1e-9, 1 - 1e-9)
        return float(-np.log(np.where(near, p, 1 - p)).sum() + 0.02 * (constants**2).sum())  # few frames tell little

    found = minimize(cost, (0.0, 0.81, 1.33, 2.64), method="Nelder-Mead", options={"maxiter": 8000})
    return [dict(zip(("mode", "mode_slope", "tips", "tips_slope"), np.round(found.x, 2).tolist(), strict=True))]


def reason_rows(frames: Sequence[Scored]) -> list[dict[str, Any]]:
    """Return the share of frames that have each kind of reason, its text before the first colon."""
    kinds = Counter(kind for f in frames for kind in dict.fromkeys(text.split(":")[0] for text in f.reasons))
    return [{"reason": name, "share": count / len(frames)} for name, count in kinds.most_common()]


def calibration_figures(found: Document | None, golden: Document) -> dict[str, Any]:
    """Return the figures of a session.json against golden.json: the base, the lag, the camera, a steered endoscope."""
    row: dict[str, Any] = {"base, deg": None, "base, mm": None, "base / std": None, "lag": None, "doubts": None}
    if found is None:
        return row
    if golden.get("camera_from_base") is not None:
        base, ratios = score_base(found, np.array(golden["camera_from_base"]))
        row |= {"base, deg": base.rotation_deg, "base, mm": base.error_mm, "base / std": float(np.abs(ratios).max())}
    row["lag"] = None if found["lag"] is None else found["lag"]["frames"]
    row["doubts"] = "; ".join(text.split(":")[0] for text in found["doubts"]) or "-"
    camera = found["blocks"].get("camera")
    row["camera contradicted"] = camera is not None and bool(camera["doubt"])
    own, truth = found["endoscope"], golden.get("endoscope")
    if own and truth and own.get("tip_from_camera") is not None:
        for name in ("tip_from_camera", "ecm_from_base"):
            off = change_between(np.array(own[name]), np.array(truth[name]))
            row[f"{name}, mm"] = 1e3 * float(np.linalg.norm(off[:3]))
            row[f"{name}, deg"] = float(np.degrees(np.linalg.norm(off[3:])))
    return row


def total_of_calibrations(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the figures of all calibrations."""
    known = [row for row in rows if row.get("base / std") is not None]
    return {
        "calibrations": len(rows),
        f"base within {_MOST_STD:g} std": sum(row["base / std"] <= _MOST_STD for row in known),
        "base, deg, median": _median(row["base, deg"] for row in known),
        "base, mm, median": _median(row["base, mm"] for row in known),
        "camera contradicted": sum(bool(row.get("camera contradicted")) for row in rows),
    }


def arms_figures(found: Document, golden: Mapping[str, Document]) -> Iterator[dict[str, Any]]:
    """Yield the errors of the bases of arms.json in that of its reference arm, given the arms' golden.json by name."""

    def true(arm: str) -> Float64:
        own = golden[arm]
        return np.array(own["endoscope"]["ecm_from_base"] if "endoscope" in own else own["camera_from_base"])

    for arm, own in found["arms"].items():
        off = change_between(np.array(own["reference_from_base"]), inverse(true(found["reference"])) @ true(arm))
        std = np.sqrt(np.diag(own["covariance"]))
        yield {
            "arm": arm,
            "off, mm": 1e3 * float(np.linalg.norm(off[:3])),
            "off, deg": float(np.degrees(np.linalg.norm(off[3:]))),
            "largest, std": float((np.abs(off) / std).max()),
        }


def _percentiles(values: Sequence[float], *shares: float) -> list[float | None]:
    return np.percentile(values, shares).tolist() if len(values) else [None] * len(shares)


def _median(values: Iterable[float | None]) -> float | None:
    return _percentiles([value for value in values if value is not None], 50)[0]


def _mean(values: Sequence[bool]) -> float | None:
    return float(np.mean(values)) if values else None
