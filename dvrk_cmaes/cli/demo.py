"""``dvrk-cmaes demo``: the bundled session, and what was found against what is true."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from dvrk_cmaes.cli.options import DEFAULT_METHOD, OUTPUT, Flag, MethodOptions
from dvrk_cmaes.cli.terminal import STATUS_STYLES, Line, show

if TYPE_CHECKING:
    from dvrk_cmaes.evaluate.pose_error import PoseError, Tolerance
    from dvrk_cmaes.frames.session_folder import Session
    from dvrk_cmaes.results.result import Result

_MAY_BE_DOUBTFUL = ("0002",)  # Tissue lies before a jaw, and the masks do not say so.


@dataclass(frozen=True, eq=False)
class Outcome:
    """A frame's result, its error, and in words what is beyond the stated tolerances."""

    result: Result
    error: PoseError
    beyond: tuple[str, ...]

    @property
    def expected(self) -> bool:
        """Whether the frame came out right, or is known to be hard and was flagged."""
        flagged = self.result.frame in _MAY_BE_DOUBTFUL and self.result.status == "doubtful"
        return not self.beyond or flagged

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        quality = self.result.quality
        return {
            "frame": self.result.frame,
            "status": self.result.status,
            "reasons": list(self.result.reasons),
            **asdict(self.error),
            "iou": None if quality is None else quality.iou,
            "seconds": self.result.seconds,
            "beyond": list(self.beyond),
            "expected": self.expected,
        }


def demo(
    *,
    out: Annotated[Path, Parameter(group=OUTPUT)] = Path("dvrk-cmaes-demo"),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    method: MethodOptions = DEFAULT_METHOD,
) -> int:
    """Run the bundled session, print what was found against the truth, and draw the overlays.

    Five frames of the bundled needle driver, drawn with a segmenter's mistakes in the masks and several degrees of
    error in the readings. Exit code 0 if all came out as expected, 1 otherwise.

    Example:

    `dvrk-cmaes demo --out demo`

    Parameters
    ----------
    out
        Folder for results and overlays.
    json
        Print the comparison as JSON, and nothing else, on stdout.
    method
        How to search.
    """
    from dvrk_cmaes.evaluate.pose_error import Tolerance
    from dvrk_cmaes.frames.session_folder import read_session
    from dvrk_cmaes.io.atomic import json_text
    from dvrk_cmaes.io.bundled import bundled_path

    # What a segmenter's mistakes allow; the tips lie 20 mm beyond the root, where 5 deg are nearly 2 mm more.
    tolerance = Tolerance(root_mm=2.0, tip_mm=3.5, shaft_deg=5.0, roll_deg=12.0, pitch_yaw_deg=8.0, jaw_deg=8.0)
    session = read_session(bundled_path("demo"))
    outcomes = list(_run(session, out, method, tolerance))
    right = all(outcome.expected for outcome in outcomes)
    if json:
        document = {
            "expected": right,
            "tolerance": asdict(tolerance),
            "out": str(out),
            "frames": [outcome.to_dict() for outcome in outcomes],
        }
        print(json_text(document), end="")
    else:
        show(_table(outcomes, asdict(tolerance), out))
    return 0 if right else 1


def _run(session: Session, out: Path, method: MethodOptions, tolerance: Tolerance) -> Iterator[Outcome]:
    """Estimate and compare the session's frames, with a bar on stderr if that is a terminal."""
    from rich.console import Console
    from rich.progress import track

    from dvrk_cmaes.evaluate.pose_error import compare_poses
    from dvrk_cmaes.frames.frame import read_frame
    from dvrk_cmaes.runs.frame import run_frame
    from dvrk_cmaes.silhouette.prepare import prepare

    config, body = method.resolve(), prepare("lnd")
    console = Console(stderr=True)
    for files in track(session.frames, "Estimating", console=console, disable=not console.is_terminal):
        result = run_frame(files, read_frame(files, session.camera), body, arm="classic", config=config, out=out).result
        assert result.camera_from_root is not None
        truth = session.truth.frames[files.name]
        error = compare_poses(
            body.instrument, (result.camera_from_root, result.joints), (truth.camera_from_root, truth.joints)
        )
        yield Outcome(result, error, tuple(error.beyond(tolerance)))


def _table(outcomes: Sequence[Outcome], tolerance: dict[str, float], out: Path) -> Iterator[Line]:
    """Errors of each frame, and where to look."""
    yield Line("Found less true, bundled session (tip and root in mm, angles in deg)", "bold")
    yield Line("frame  status      tip   root  shaft  rotation  pitch    yaw    jaw    IoU      s", "bold")
    for one in outcomes:
        result, error, joints = one.result, one.error, one.error.joints_deg
        iou = float("nan") if result.quality is None else result.quality.iou
        yield Line(
            f"{result.frame:<6s} {result.status:<8s} {error.tip_mm or 0.0:>6.2f} {error.root_mm:>6.2f} "
            f"{error.shaft_deg:>6.2f} {error.rotation_deg:>9.2f} {joints['wrist_pitch']:>+6.2f} "
            f"{joints['wrist_yaw']:>+6.2f} {joints['jaw']:>+6.2f} {iou:>6.3f} {result.seconds:>6.2f}",
            "" if one.expected else STATUS_STYLES["failed"],
        )
    for one in outcomes:
        for text in (*one.result.reasons, *(f"beyond tolerance: {text}" for text in one.beyond)):
            yield Line(f"{one.result.frame}: {text}", "yellow")
    right = sum(one.expected for one in outcomes)
    stated = ", ".join(f"{name.rsplit('_', 1)[0].replace('_', '/')} {most:g}" for name, most in tolerance.items())
    yield Line(f"{right} of {len(outcomes)} frames as expected (at most: {stated})")
    yield Line(f"Overlays: {out / 'overlays'}   results: {out / 'frames'}")
