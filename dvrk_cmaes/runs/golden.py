"""Golden poses of a lab's own frames: recording them from results, and comparing later results with them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.evaluate.pose_check import PoseCheck, check_pose
from dvrk_cmaes.evaluate.pose_error import Tolerance
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.truth import FrameTruth, SessionTruth
from dvrk_cmaes.geometry import apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.exchanged_tools import ArmInSession
from dvrk_cmaes.runs.frame import estimate_frame


@dataclass(frozen=True, eq=False)
class GoldenRecord:
    """Golden poses ``truth``, and the reasons for frames that were ``left_out``, by name."""

    truth: SessionTruth
    left_out: Mapping[str, str]


def estimate_all(frames: Iterable[FrameFiles], arm: ArmInSession, config: EstimateConfig) -> Iterator[Result]:
    """Estimate frames of a session one after the other; a frame with an error gives a failed result with the reason."""
    camera, model = arm.session.camera, arm.body.instrument
    for files in frames:
        try:
            yield estimate_frame(files, read_frame(files, camera), arm.body, FrameMethod(arm.kinematics, config))
        except DvrkCmaesError as error:
            yield Result.failed(files.name, str(error), files.readings, **model.stated, time=files.time)


def record(results: Iterable[Result], instrument: Instrument, *, allow_doubtful: bool = False) -> GoldenRecord:
    """Return the poses of the results that are ok and, if ``allow_doubtful``, of those that are doubtful."""
    kept: dict[str, FrameTruth] = {}
    left_out: dict[str, str] = {}
    for result in results:
        if result.camera_from_root is None or (result.status != "ok" and not allow_doubtful):
            left_out[result.frame] = f"{result.status}: {'; '.join(result.reasons)}"
            continue
        ends = instrument.ends([result.joints[name] for name in instrument.joint_names])
        tips = apply(result.camera_from_root, ends)
        kept[result.frame] = FrameTruth(result.camera_from_root, result.joints, tips)
    return GoldenRecord(SessionTruth(kept), left_out)


@dataclass(frozen=True, eq=False)
class FrameCheck:
    """A frame's result, and its comparison with the golden pose."""

    result: Result
    check: PoseCheck

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; keys of errors have the unit: ``root_mm``, ``wrist_pitch_deg`` and so on."""
        return {
            "frame": self.result.frame,
            "status": self.result.status,
            "reasons": list(self.result.reasons),
            "right": self.check.right,
            "is_twin": self.check.is_twin,
            "errors": {f"{measured.quantity}_{measured.unit}": measured.error for measured, _, _ in self.check.rows},
            "off": [measured.quantity for measured, _, _ in self.check.rows if measured.exceeds],
        }


def check(
    results: Iterable[Result],
    golden: SessionTruth,
    instrument: Instrument,
    tolerance: Tolerance,
    *,
    modulo_twin: bool = False,
) -> Iterator[FrameCheck]:
    """Compare results with their golden poses, one after the other.

    Parameters
    ----------
    results
        Results of frames that have a golden pose.
    golden
        The golden poses.
    instrument
        The instrument of both.
    tolerance
        The largest errors of a result that is right.
    modulo_twin
        Whether the mirror twin of the golden pose is right, too.
    """
    for result in results:
        found = check_pose(result, golden.frames[result.frame], instrument, tolerance, modulo_twin=modulo_twin)
        yield FrameCheck(result, found)
