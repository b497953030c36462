"""``dvrk-cmaes demo``: estimation of the bundled session, and comparison with its true poses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from dvrk_cmaes.cli.options import DEFAULT_METHOD, OUTPUT, Flag, MethodOptions
from dvrk_cmaes.cli.terminal import STATUS_STYLES, Line, answer, tracked

if TYPE_CHECKING:
    from dvrk_cmaes.evaluate.pose_error import PoseError, Tolerance
    from dvrk_cmaes.frames.session_folder import Session
    from dvrk_cmaes.results.result import Result


@dataclass(frozen=True, eq=False)
class DemoOutcome:
    """Result of a frame, its error, and one message for each error beyond its tolerance."""

    result: Result
    error: PoseError
    beyond: tuple[str, ...]

    @property
    def expected(self) -> bool:
        """Whether all errors are within the limits, or the frame is marked doubtful."""
        return not self.beyond or self.result.status == "doubtful"

    @property
    def deviations(self) -> float:
        """The tips' error in stated standard deviations; infinite if none is stated."""
        stated = self.result.expected_error
        return math.inf if stated is None or self.error.tip_mm is None else self.error.tip_mm / stated.of_tips_mm

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        from dvrk_cmaes.io.encode import encoded_fields

        quality = self.result.quality
        return {
            **encoded_fields(self.result, "frame", "status", "reasons"),
            **encoded_fields(self.error, "root_mm", "tip_mm", "rotation_deg", "shaft_deg", "roll_deg", "joints_deg"),
            "iou": None if quality is None else quality.iou,
            "seconds": self.result.seconds,
            "beyond": list(self.beyond),
            "expected": self.expected,
            "deviations": self.deviations,
        }


def demo(
    *,
    out: Annotated[Path, Parameter(group=OUTPUT)] = Path("dvrk-cmaes-demo"),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    method: MethodOptions = DEFAULT_METHOD,
) -> int:
    """Estimate the bundled session, print the errors against the true poses, and write results and overlays.

    The session has five synthetic frames of the bundled needle driver, with simulated segmentation errors in the masks
    and errors of several degrees in the readings. Exit code 0 if every frame is within the limits, 1 otherwise.

    Example:

    ```
    dvrk-cmaes demo --out demo
    ```

    Parameters
    ----------
    out
        Folder for the results and the overlays.
    json
        Print only the comparison, as JSON, on stdout.
    method
        The method.
    """
    from dvrk_cmaes.evaluate.pose_error import Tolerance
    from dvrk_cmaes.frames.session_folder import read_session
    from dvrk_cmaes.io.bundled import bundled_path

    # for masks with segmentation errors; the tips' limit is that beyond which results are doubtful
    tolerance = Tolerance(root_mm=2.0, tip_mm=2.0, shaft_deg=5.0, roll_deg=12.0, pitch_yaw_deg=8.0, jaw_deg=8.0)
    session = read_session(bundled_path("demo"))
    outcomes = list(_run(session, out, method, tolerance))
    right = not any(outcome.beyond for outcome in outcomes)
    document = {
        "expected": right,
        "tolerance": asdict(tolerance),
        "out": str(out),
        "frames": [outcome.to_dict() for outcome in outcomes],
    }
    answer(document, _table(outcomes, asdict(tolerance), out), json=json)
    return 0 if right else 1


def _run(session: Session, out: Path, method: MethodOptions, tolerance: Tolerance) -> Iterator[DemoOutcome]:
    """Estimate the session's frames and compare them with the truth; show a progress bar if stderr is a terminal."""
    from dvrk_cmaes.estimation.one_tool import FrameMethod
    from dvrk_cmaes.evaluate.pose_error import compare_poses
    from dvrk_cmaes.frames.frame import read_frame
    from dvrk_cmaes.runs.frame import run_frame
    from dvrk_cmaes.silhouette.prepare import prepare

    config, body = method.resolve(), prepare("lnd")
    for files in tracked(session.frames, "Estimating"):
        data, solved_as = read_frame(files, session.camera), FrameMethod("classic", config)
        result, _ = run_frame(files, data, body, solved_as, out, command="demo")
        assert result.camera_from_root is not None
        truth = session.truth.frames[files.name]
        error = compare_poses(
            body.instrument, (result.camera_from_root, result.joints), (truth.camera_from_root, truth.joints)
        )
        yield DemoOutcome(result, error, tuple(error.beyond(tolerance)))


def _table(outcomes: Sequence[DemoOutcome], tolerance: dict[str, float], out: Path) -> Iterator[Line]:
    """Yield the table of the frames' errors, the messages, and the folders of the files written."""
    yield Line("Error (found - true), bundled session (tip and root in mm, angles in deg)", "bold")
    yield Line("frame  status     tip stated  root shaft rotation  pitch    yaw    jaw   IoU    s", "bold")
    for outcome in outcomes:
        result, error, joints = outcome.result, outcome.error, outcome.error.joints_deg
        iou = math.nan if result.quality is None else result.quality.iou
        stated = math.nan if result.expected_error is None else result.expected_error.of_tips_mm
        yield Line(
            f"{result.frame:<6s} {result.status:<8s} {error.tip_mm or 0.0:>5.2f} {stated:>6.2f} {error.root_mm:>5.2f} "
            f"{error.shaft_deg:>5.2f} {error.rotation_deg:>8.2f} {joints['wrist_pitch']:>+6.2f} "
            f"{joints['wrist_yaw']:>+6.2f} {joints['jaw']:>+6.2f} {iou:>5.3f} {result.seconds:>4.1f}",
            "" if outcome.expected else STATUS_STYLES["failed"],
        )
    for outcome in outcomes:
        for text in (*outcome.result.reasons, *(f"beyond the limit: {text}" for text in outcome.beyond)):
            yield Line(f"{outcome.result.frame}: {text}", "yellow")
        if not outcome.expected:
            many = f"the tips' error is {outcome.deviations:.1f} of their stated standard deviations"
            yield Line(f"{outcome.result.frame}: not doubtful; {many}", "yellow")
    right = sum(not outcome.beyond for outcome in outcomes)
    limits = ", ".join(f"{name.rsplit('_', 1)[0].replace('_', '/')} {most:g}" for name, most in tolerance.items())
    yield Line(f"{right} of {len(outcomes)} frames within the limits (at most: {limits})")
    yield Line("stated: the tips' error to expect, one standard deviation, as each result states it, mm")
    yield Line(f"Overlays: {out / 'overlays'}   results: {out / 'frames'}")
