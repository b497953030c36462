"""``dvrk-cmaes demo``: estimation of the bundled session, and comparison with its true poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dvrk_cmaes.cli.golden import answer_checks
from dvrk_cmaes.cli.options import OUTPUT, Flag, MethodOptions
from dvrk_cmaes.cli.terminal import FAILED, Line, show, tracked


def demo(
    *,
    out: Annotated[Path, Parameter(group=OUTPUT)] = Path("dvrk-cmaes-demo"),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    method: MethodOptions = MethodOptions(),
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
    from dvrk_cmaes.estimation.one_tool import FrameMethod
    from dvrk_cmaes.evaluate import Tolerance
    from dvrk_cmaes.frames.frame import read_frame
    from dvrk_cmaes.frames.session_folder import read_session
    from dvrk_cmaes.io.files import bundled_path
    from dvrk_cmaes.io.output import LONG, output
    from dvrk_cmaes.report.page import write_page
    from dvrk_cmaes.runs.frame import run_frame
    from dvrk_cmaes.silhouette.prepare import prepare

    # for masks with segmentation errors; the tips' limit is that beyond which results are doubtful
    tolerance = Tolerance(root_mm=2.0, tip_mm=2.0, shaft_deg=5.0, roll_deg=12.0, pitch_yaw_deg=8.0, jaw_deg=8.0)
    session, body = read_session(bundled_path("demo")), prepare("lnd")
    solved_as = FrameMethod("classic", method.resolve())
    results = (
        run_frame(read_frame(files, session.camera), body, solved_as, out, command="demo")[0]
        for files in tracked(session.frames, "Estimating")
    )
    golden = session.truth.frames
    right = answer_checks(results, golden, body.instrument, tolerance, {"out": str(out)}, json=json)
    with output(out, "demo", wait=LONG):
        page = write_page(out)
    if not json:
        show([Line(f"page: {page}   results: {out / 'frames'}")])
        show([Line(f"next: dvrk-cmaes calibrate {session.folder} --out calibrated")])
        show([Line("of your own files: dvrk-cmaes inspect FOLDER")])
    return 0 if right else FAILED
