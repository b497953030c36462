"""``dvrk-cmaes calibrate``: joint solution of a session's frames for camera_from_base and the joints' offsets."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    CAMERA,
    FOLDER,
    MOST_PROCESSES,
    MOST_SKIPPED,
    OUTPUT,
    WORKERS,
    Flag,
    ReadingOptions,
    SessionOptions,
    options,
    whole,
)
from dvrk_cmaes.cli.session_tools import (
    ArmReport,
    found_lines,
    open_session,
    output_folder,
    reason_lines,
    report_arms,
)
from dvrk_cmaes.cli.terminal import DOUBTFUL, INTERRUPTED, STATUS_STYLES, Line, attended, note, progress
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.calibrate import SolvedSession
    from dvrk_cmaes.calibration.together import Begun
    from dvrk_cmaes.runs.frame import ArmInSession

_LEAST_KEYFRAMES = 3
_FIRST_FRAMES = 30  # at most, from which a camera without a file is found first


@options(group=FOLDER)
class CalibrateOptions:
    """What is solved together, and where results go.

    Parameters
    ----------
    results
        Folder of the results of `batch` for this session. By default `batch` is run first, with the results in
        OUT/alone.
    out
        Folder for session.json, the frames' results and the HTML report; SESSION/calibration by default.
    joints
        File of readings to use instead of the session's own. May be given several times.
    frames
        Calibrate only the frames whose names match this shell pattern, e.g. "00*", as of batch; all by default.
    keyframes
        Calibrate at most N frames of a recording: those well in view, far from each other in time and pose.
    lag
        Lag of the images behind the readings, in seconds or frames, such as 0.13 or 4frames; 0 for none. By default it
        is estimated in recordings, whose readings move smoothly from row to row.
    refine_camera
        Estimate the focal length and the principal point together with the base. They are written to OUT/camera.yaml;
        of two eyes, which are changed alike, to OUT/left.yaml and OUT/right.yaml. Needs at least 6 frames and 5 mm of
        insertion.
    focal
        There is no camera file, and the focal length is about this, px. The camera is then found from the frames, as it
        is where a session has no camera file and none is given.
    workers
        Number of processes that work at a time; by default the number of cores. Few frames are done by one.
    """

    results: Path | None = None
    out: Path | None = None
    joints: Annotated[tuple[Path, ...], Parameter(negative=(), show_default=False)] = ()
    frames: str | None = None
    keyframes: Annotated[int | None, whole(_LEAST_KEYFRAMES, MOST_SKIPPED)] = None
    lag: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    refine_camera: Flag = False
    focal: Annotated[float | None, Parameter(group=CAMERA)] = None
    workers: Annotated[int | None, whole(1, MOST_PROCESSES, group=WORKERS)] = None

    def check(self, place: Path) -> None:
        """Raise an InputError for values that are not valid; ``place`` is the folder that is written."""
        if self.results is not None and self.results.resolve() == place.resolve():
            expected = "expected another folder than --results, whose frames stay as they are"
            raise InputError(f"--out: {expected}, got {place}")

    def guess(self, camera: Path | None) -> float | Literal["usual"] | None:
        """Return the focal length to use where there is no camera file, as of `read_session`; None if there is one."""
        if self.focal is not None and camera is not None:
            raise InputError("--focal: expected either this or --camera, got both")
        return ("usual" if self.focal is None else self.focal) if camera is None else None

    def share(self, arm: ArmInSession) -> ArmInSession:
        """Return an arm with the frames of its session that match the pattern, or keyframes of these, and settings."""
        from dvrk_cmaes.runs.keyframes import with_keyframes
        from dvrk_cmaes.runs.manifest import chosen_frames

        chosen = replace(arm.session, frames=chosen_frames(arm.session.frames, self.frames))
        if self.keyframes is None:
            return replace(arm, session=chosen)
        return replace(arm, session=with_keyframes(chosen, self.keyframes))

    def with_camera(self, arm: ArmInSession) -> ArmInSession | None:
        """Return a session whose camera is guessed with that estimated from some of its frames; None if interrupted.

        The frames are estimated again with that: with a guess that is far off, their poses disagree.
        """
        from tempfile import TemporaryDirectory

        from dvrk_cmaes.calibration.together import solved_alone
        from dvrk_cmaes.camera import Rig

        frames = arm.session.frames[:: -(-len(arm.session.frames) // _FIRST_FRAMES)]
        note(f"finding the camera with {len(frames)} frames")
        with TemporaryDirectory(prefix="dvrk-cmaes-") as folder:
            few = replace(arm, session=replace(arm.session, frames=frames))
            solved = solved_alone(self.begin(few, Path(folder) / "session", refine=True))
        if solved is None:
            return None
        covariance = arm.session.rig.views[0].camera.covariance
        views = [view.restored() for view in solved.calibration.views]
        rig = Rig(tuple(replace(view, camera=replace(view.camera, covariance=covariance)) for view in views))
        return replace(arm, session=replace(arm.session, rig=rig))

    def begin(
        self, arm: ArmInSession, target: Path, results: Path | None = None, *, refine: bool
    ) -> Begun[SolvedSession | None]:
        """Solve an arm's session from its results, or after estimating them; its result is None if interrupted."""
        from dvrk_cmaes.calibration.together import Begun
        from dvrk_cmaes.io.output import output
        from dvrk_cmaes.joints.lag import Lag
        from dvrk_cmaes.results.folder import ALONE, ResultsFolder, read_results
        from dvrk_cmaes.runs.batch import run_batch
        from dvrk_cmaes.runs.pool import Workers, pool_of, usable_cores

        lag = None if self.lag is None else Lag.parse("--lag", self.lag)
        with ExitStack() as stack:
            stack.enter_context(output(target, "calibrate", kept=(ALONE,)))
            most, frames = self.workers or usable_cores(), None if results is None else arm.session.frames
            pool = stack.enter_context(pool_of(most, frames))
            if results is not None:
                alone = read_results(results)
            else:
                one = arm.with_config(replace(arm.method.config, threads=1))
                with attended(executor=pool) as by:
                    done = run_batch(one, target / ALONE, workers=by)
                if done.interrupted:
                    return Begun.of(None)
                alone = ResultsFolder(target / ALONE, done.results, None, None)
            by = Workers(notice=note, report=stack.enter_context(progress()))
            from dvrk_cmaes.runs.calibrate_folder import begin_folder

            begun = begin_folder(arm, target, alone, pool, by, refine_camera=refine, lag=lag)
            return begun.within(stack.pop_all())


def calibrate(
    session: Annotated[Path, Parameter(group=FOLDER)],
    /,
    *,
    wanted: CalibrateOptions = CalibrateOptions(),
    reading: ReadingOptions = ReadingOptions(),
    given: SessionOptions = SessionOptions(),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Calibrate a session: estimate the pose of the arm's base in the camera and the offset of each joint's readings.

    All frames are solved together. It is assumed that the base does not move, that the readings of the outer joints are
    good, and that the errors of the cable-driven joints are mostly one offset in the session. Each frame's pose is
    estimated as well, given the calibration. The table [session] of the settings file configures this command.

    Exit codes: 0 ok, 1 the work could not be done, 2 wrong usage or input, 3 finished, but the session is doubtful or a
    frame that was solved with it, 130 interrupted.

    Example:

    ```
    dvrk-cmaes calibrate session --results session/results --out calibrated
    ```

    Afterwards `dvrk-cmaes estimate ... --session calibrated/session.json` starts new frames from the calibration.

    Parameters
    ----------
    session
        Session folder, as for `batch`; the readings must include the outer joints yaw, pitch, insertion and roll.
    wanted
        What is solved together, and where results go.
    reading
        How files of readings are read.
    given
        The arms, the camera, the instrument and the settings. The poses of several arms' bases relative to the first
        one's are in OUT/arms.json.
    json
        Print only session.json, on stdout.
    """
    from dvrk_cmaes.calibration.calibrate import check_outer_joints
    from dvrk_cmaes.calibration.together import Begun, solved_together
    from dvrk_cmaes.instrument.setup_joints import SETUP, read_setup_joints
    from dvrk_cmaes.io.output import output
    from dvrk_cmaes.results.folder import ALONE
    from dvrk_cmaes.runs.manifest import check_same_session

    wanted.check(session / "calibration" if wanted.out is None else wanted.out)
    with output_folder(wanted.out, session, "calibration", "calibrate") as target:
        setup = read_setup_joints(session / SETUP)
        focal = wanted.guess(given.camera.camera)
        read = open_session(session, given, joints=wanted.joints, reading=reading, focal=focal, together=True)
        arms = {name: wanted.share(arm) for name, arm in read.items()}
        for name, arm in arms.items():
            check_outer_joints([files.readings for files in arm.session.frames])
            with output(target / name, "calibrate", kept=(ALONE,)):
                check_same_session(target / name, arm.session)

        def begin(name: str) -> Begun[SolvedSession | None]:
            own = None if wanted.results is None else wanted.results / name
            arm = arms[name] if own is not None or not arms[name].session.guessed else wanted.with_camera(arms[name])
            if arm is None:
                return Begun.of(None)
            return wanted.begin(arm, target / name, own, refine=wanted.refine_camera)

        with progress():
            found = solved_together({name: partial(begin, name) for name in arms})
        solved = {name: solution for name, solution in found.items() if solution is not None}
        if len(solved) < len(arms):
            return INTERRUPTED
        reports = {name: _report_of(solution, target / name, json=json) for name, solution in solved.items()}
        return report_arms(reports, target, setup, json=json)


def _report_of(solved: SolvedSession, out: Path, *, json: bool) -> ArmReport:
    """Return what is said of an arm that is doubtful if the session is, or a frame that was solved with it."""
    calibration = solved.calibration
    warnings = calibration.remarks if not json else calibration.warnings
    statuses = {calibration.status, *(solved.results[name].status for name in solved.leave_one_out)}
    code = DOUBTFUL if statuses != {"ok"} else 0
    return ArmReport(calibration.to_dict(), _lines(solved, out), warnings, code, solved.results, calibration)


def _lines(solved: SolvedSession, out: Path) -> Iterator[Line]:
    """Yield the lines of a calibration: base, offsets, frames left out, leave-one-out errors, and the files written."""
    for doubt in solved.calibration.doubts:
        yield Line(f"doubtful: {doubt}", STATUS_STYLES["doubtful"])
    yield from found_lines(solved.calibration)
    yield from reason_lines({name: result.reasons for name, result in solved.results.items()})
    doubtful = [result for result in solved.results.values() if result.status == "doubtful"]
    if doubtful:
        yield Line(f"{len(doubtful)} of {len(solved.results)} frames are doubtful", STATUS_STYLES["doubtful"])
    yield Line(f"written: {out / 'session.json'}   frames: {out / 'frames'}   page: {out / 'report.html'}")
