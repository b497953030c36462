"""Calibration of a session folder from its frames' own results, in several processes, with all files written.

OUT/session.json, OUT/camera.yaml (a refined camera; of a rig that was changed, OUT/left.yaml and OUT/right.yaml),
OUT/frames/FRAME.json, OUT/overlays/FRAME.jpg, OUT/overlays_left_out/FRAME.jpg, OUT/poses.csv,
OUT/summary.json, OUT/report.html
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from dvrk_cmaes.calibration.calibrate import SolvedSession, begin_arm
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.masks_and_sizes import MARGIN
from dvrk_cmaes.calibration.session_camera import of_the_camera_found
from dvrk_cmaes.calibration.session_frame import SessionFrame
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.calibration.together import Begun
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.camera.rig import ViewDocument
from dvrk_cmaes.camera.ros import view_info_text
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.io.json_file import write_json, write_text
from dvrk_cmaes.io.output import output, whole_folder, write_bytes
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.results.folder import (
    ALONE,
    SESSION,
    ResultsFolder,
    check_output,
    left_out_path,
    overlay_path,
)
from dvrk_cmaes.runs.agreement import with_found_masks
from dvrk_cmaes.runs.batch import finish
from dvrk_cmaes.runs.calibration_pictures import draw_task
from dvrk_cmaes.runs.frame import ArmInSession, FrameOutcome, write_outcome
from dvrk_cmaes.runs.manifest import manifest_of
from dvrk_cmaes.runs.pool import Pool, Workers, run_in

CAMERA = "camera.yaml"
"""File of the camera with which the session was solved, where that is not the session's own; of a rig, VIEW.yaml."""


def begin_folder(
    arm: ArmInSession, out: Path, alone: ResultsFolder, pool: Pool, by: Workers, *, refine_camera: bool, lag: Lag | None
) -> Begun[SolvedSession]:
    """Solve an arm's session from its frames' own results; what `solved_together` finishes writes everything.

    Masks that were found in images, and overlays of frames that are left out, are taken from the folder of these
    results, ``alone``. All files are written to a temporary folder, which takes the place of an earlier ``out`` when
    it is whole.

    Raises
    ------
    InputError
        As `dvrk_cmaes.calibrate_session`; results of another instrument; a folder that cannot be written to.
    DvrkCmaesError
        A process died, or the disk is full.
    """
    session, instrument, config = arm.session, arm.body.instrument, arm.method.config
    files = {own.name: with_found_masks(own, alone.folder) for own in session.frames}
    frames = []
    for name, own in files.items():
        check_output(out, name)
        if (result := alone.frames.get(name)) is None:
            continue
        if result.instrument != instrument.name:
            raise InputError(
                f"frame {name}: instrument: expected {instrument.name}, got a result of {result.instrument}"
            )
        frames.append(SessionFrame(name, functools.partial(read_frame, own, session.rig), result, own.keypoints))
    if not all(each.has_mask for each in session.frames):
        config = config.with_alike_masks()
    run, refined = run_in(pool, arm.body, config, by), (refine_camera or session.guessed)
    series, kinematics = session.reading_series(), arm.method.arm
    setup = ArmSetup(series, instrument, kinematics, config, run, by.stage, refined, session.guessed, lag=lag)
    return begin_arm(frames, setup).then(functools.partial(_written, arm, out, alone.folder, files, setup))


def _written(
    arm: ArmInSession,
    out: Path,
    alone: Path,
    files: Mapping[str, FrameFiles],
    setup: ArmSetup,
    found: tuple[SolvedSession, dict[str, Evidence]],
) -> SolvedSession:
    """Write a calibration with drawings of its frames; returns it with the cameras with which it was solved."""
    (solved, evidence), session = found, arm.session
    setup.progress("drawing", len(solved.leave_one_out))
    corrected = Rig(solved.calibration.corrected_views(session.rig.views))
    calibration = replace(solved.calibration, views=tuple(ViewDocument.of(view) for view in corrected.views))
    # the camera that was found is the session's from here on
    camera = calibration.blocks.get("camera")
    if session.guessed and camera is not None:
        known = of_the_camera_found(camera, corrected.views[0].camera)
        calibration = replace(calibration, blocks={**calibration.blocks, "camera": known})
        session = replace(session, rig=corrected)
    solved = replace(solved, calibration=calibration)
    left_out = solved.leave_one_out
    tasks = [(files[k], solved.results[k], own, evidence[k]) for k, own in left_out.items()]
    drawn = setup.run(functools.partial(draw_task, rig=session.rig, calibrated=corrected), tasks)
    pictures = dict(zip(left_out, drawn, strict=True))
    with whole_folder(out, "calibrate", overwrite=True, kept=(ALONE,)) as place:
        for name, result in solved.results.items():
            if name in pictures:
                overlay, left_out_overlay = pictures[name]
                write_bytes(left_out_path(place, name), left_out_overlay)
            else:
                overlay = kept.read_bytes() if (kept := overlay_path(alone, name)).is_file() else None
            write_outcome(place, FrameOutcome(result, overlay))
        write_cameras(calibration, session.rig, place)
        write_json(place / SESSION, calibration.to_dict())
        used = (own for own in session.frames if own.name in solved.results)
        with output(place, "calibrate") as own:
            own.describe(manifest_of(replace(arm, session=session), used) | {"solved": "together"})
        finish(place, trust=arm.method.config.trust)
    return solved


def write_cameras(calibration: SessionCalibration, rig: Rig, out: Path) -> None:
    """Write the cameras with which a session was solved, where they are not those of its files, for raw images."""
    if not {name for name, found in calibration.blocks.items() if found.applied} - {MARGIN}:
        return
    first, *others = calibration.corrected_views(rig.views)
    write_text(out / (f"{first.name}.yaml" if others else CAMERA), view_info_text(first, "refined"))
    for view in others:
        write_text(out / f"{view.name}.yaml", view_info_text(view, f"refined {view.name}"))
