"""Calibration of a session folder from its frames' own results, in several processes, with all files written.

OUT/session.json, OUT/camera.yaml (a refined camera), OUT/frames/FRAME.json, OUT/overlays/FRAME.jpg,
OUT/overlays_left_out/FRAME.jpg, OUT/layers/FRAME.json, OUT/poses.csv, OUT/summary.json, OUT/report.html
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.calibration import SessionFrame, SolvedSession, calibrate_with_evidence
from dvrk_cmaes.calibration.frame_task import LeaveOneOutPrediction
from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.draw.left_out_overlay import draw_left_out
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.frames.frame import FrameData, FrameFiles
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.atomic import encoded_image, write_bytes, write_json
from dvrk_cmaes.results.folder import SESSION
from dvrk_cmaes.results.layers import FrameLayers
from dvrk_cmaes.results.paths import check_output, layers_path, left_out_path, mask_path, overlay_path, result_path
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.batch import finish
from dvrk_cmaes.runs.digests import frame_digests, instrument_digest
from dvrk_cmaes.runs.frame import draw_frame, layers_of_frame, read_masked_frame, seen_in
from dvrk_cmaes.runs.manifest import manifest_of, write_manifest
from dvrk_cmaes.runs.processes import Processes, WorkerDied
from dvrk_cmaes.runs.worker import BatchSetup, prepare_instrument, prepared_body
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import body_by
from dvrk_cmaes.synth.files import write_camera_info

CAMERA = "camera.yaml"
"""File of the camera with which the session was solved, where that is not the session's own."""


@dataclass(frozen=True, eq=False)
class DrawTask:
    """Draw a frame's result and what the session's other frames predict for it; ``files`` has a mask.

    ``camera`` is that of the camera file or the rig, ``calibrated`` the one with which the session was solved, and
    ``evidence`` what was found with it.
    """

    files: FrameFiles
    camera: Camera | Rig
    calibrated: Camera | Rig
    result: Result
    left_out: LeaveOneOutPrediction
    evidence: Evidence


@dataclass(frozen=True)
class Pictures:
    """The drawings of a frame: the overlay of its result and that of its leave-one-out prediction, JPEG; its layers."""

    overlay: bytes
    left_out: bytes
    layers: FrameLayers


def draw_task(body: Body, config: EstimateConfig, task: DrawTask) -> Pictures:
    """Draw one frame."""
    data = read_masked_frame(task.files, task.calibrated)
    # a frame that is left out keeps its own result
    drawn = data if task.result.source == "session" else read_masked_frame(task.files, task.camera)
    overlay = draw_frame(task.result, task.files, drawn, body, task.evidence if drawn is data else None)
    left_out = task.left_out
    shown = []
    for view in seen_in(data):
        renderer, pose = Renderer(body, view.camera, threads=1), view.view_from_camera @ left_out.camera_from_root
        predicted = renderer.masks(pose[None], left_out.joints[None])[0]
        shown.append(draw_left_out(view.mask, predicted, left_out.iou, left_out.contour_px, image=view.image))
    second = np.concatenate(shown, axis=1)
    layers = layers_of_frame(task.result, drawn, body)
    return Pictures(encoded_image("overlay.jpg", overlay), encoded_image("left_out.jpg", second), layers)


def calibrate_folder(
    session: Session,
    results: Mapping[str, Result],
    instrument: Instrument,
    out: Path,
    *,
    alone: Path | None = None,
    arm: Arm = "classic",
    refine_camera: bool = False,
    config: EstimateConfig,
    workers: int,
    processes: Processes | None = None,
    progress: Callable[[str, int], None] = lambda stage, count: None,
) -> SolvedSession:
    """Calibrate a session folder from its frames' own results, and write everything to a folder.

    ``alone`` is the folder of those results; masks that were found in images, and overlays of frames that are left out,
    are taken from there. ``processes`` are those of `instrument_processes` to use instead of ``workers`` new ones.

    Raises
    ------
    InputError
        As `dvrk_cmaes.calibrate_session`; results of another instrument; a folder that cannot be written to.
    DvrkCmaesError
        A process died, or the disk is full.
    """
    files = {one.name: _with_mask(one, alone) for one in session.frames}
    frames = []
    for name, one in files.items():
        check_output(out, name)
        if name not in results:
            continue
        result = results[name]
        if result.instrument != instrument.name:
            raise InputError(
                f"frame {name}: instrument: expected {instrument.name}, got a result of {result.instrument}"
            )
        # The image is only needed for the overlay.
        reader = functools.partial(_read_without_image, one, session.cameras)
        frames.append(SessionFrame(name, reader, result, one.keypoints))
    with ExitStack() as stack:
        used = stack.enter_context(instrument_processes(instrument, workers)) if processes is None else processes
        run = functools.partial(_run, used, instrument_digest(instrument), config)
        solved, evidence = calibrate_with_evidence(
            frames,
            instrument,
            series=session.reading_series(),
            arm=arm,
            refine_camera=refine_camera,
            config=config,
            run=run,
            progress=progress,
        )
        progress("drawing", len(solved.leave_one_out))
        for name in (SESSION, CAMERA):
            (out / name).unlink(missing_ok=True)
        camera = solved.calibration.corrected(session.camera) if session.rig is None else session.rig
        tasks = [
            DrawTask(files[name], session.cameras, camera, solved.results[name], left_out, evidence[name])
            for name, left_out in solved.leave_one_out.items()
        ]
        pictures = dict(zip(solved.leave_one_out, run(draw_task, tasks), strict=True))
    _write(solved, pictures, session, instrument, out, arm, config, alone)
    return solved


def instrument_processes(instrument: Instrument, workers: int) -> Processes:
    """Return worker processes in which an instrument is prepared once, for `run_batch` and `calibrate_folder`."""
    return Processes(functools.partial(_start, instrument), workers)


def _run(
    processes: Processes,
    key: str,
    config: EstimateConfig,
    function: Callable[[Body, EstimateConfig, Any], Any],
    tasks: Sequence[Any],
) -> list[Any]:
    """Return the values of a function of body, settings and task, in the order of the tasks.

    ``key`` is the digest of the instrument that is prepared in the processes.
    """
    values = {}
    for (number, _), value in processes.run(enumerate(tasks), functools.partial(_call, key, config, function)):
        if isinstance(value, WorkerDied):
            raise DvrkCmaesError(f"frame {number + 1} of {len(tasks)}: {value.reason}: try fewer --workers")
        values[number] = value
    return [values[number] for number in range(len(tasks))]


def _start(instrument: Instrument) -> None:
    """Build the instrument's scenes in a worker process; returns nothing, since scenes cannot be sent back."""
    prepare_instrument(instrument)


def _call(
    key: str,
    config: EstimateConfig,
    function: Callable[[Body, EstimateConfig, Any], Any],
    numbered: tuple[int, Any],
) -> Any:
    return function(body_by(prepared_body(key), config.silhouette.method), config, numbered[1])


def _with_mask(files: FrameFiles, alone: Path | None) -> FrameFiles:
    """Return a frame with the mask that was found in its image, where it has no mask of its own."""
    if files.mask is not None or alone is None:
        return files
    mask = mask_path(alone, files.name)
    return replace(files, mask=mask if mask.exists() else None)


def _read_without_image(files: FrameFiles, camera: Camera | Rig) -> FrameData:
    others = {name: replace(one, image=None) for name, one in files.others.items()}
    return read_masked_frame(replace(files, image=None, others=others), camera)


def _write(
    solved: SolvedSession,
    pictures: Mapping[str, Pictures],
    session: Session,
    instrument: Instrument,
    out: Path,
    arm: Arm,
    config: EstimateConfig,
    alone: Path | None,
) -> None:
    """Write results, pictures, tables and page; session.json after its frames."""
    for name, result in solved.results.items():
        if name in pictures:
            write_bytes(overlay_path(out, name), pictures[name].overlay)
            write_bytes(left_out_path(out, name), pictures[name].left_out)
            write_json(layers_path(out, name), pictures[name].layers.to_dict())
        else:
            left_out_path(out, name).unlink(missing_ok=True)
            for path in (overlay_path, layers_path):
                if alone is not None and path(alone, name).is_file():
                    write_bytes(path(out, name), path(alone, name).read_bytes())
        write_json(result_path(out, name), result.to_dict())
    calibration = solved.calibration
    if calibration.camera is not None and calibration.camera.applied:
        write_camera_info(out / CAMERA, calibration.corrected(session.camera), "refined")
    write_json(out / SESSION, calibration.to_dict())
    setup = BatchSetup(instrument, session.camera, config, arm, session.folder, rig=session.rig)
    digests = {files.name: frame_digests(files) for files in session.frames if files.name in solved.results}
    write_manifest(out, manifest_of(setup, digests) | {"solved": "together"})
    finish(out)
