"""One frame of a batch in a worker process: from the frame's files to the bytes of its result and overlay.

The settings that all frames share are sent pickled and unpickled once in each process, where the instrument's Embree
scenes are built, which cannot be pickled. Errors do not leave this module: a frame with an error gets a ``failed``
result with the reason.
"""

from __future__ import annotations

import functools
import os
import pickle
import socket
import threading
import traceback
from dataclasses import dataclass, field, replace
from pathlib import Path

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.atomic import encoded_image
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import FrameOutcome, draw_failed_frame, outcome_of
from dvrk_cmaes.runs.manifest import instrument_digest
from dvrk_cmaes.runs.pool import limit_library_threads
from dvrk_cmaes.segment.segmentation import Hints, SegmentSettings, hints_within
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare

_unpacking = threading.Lock()
_prepared: dict[str, Body] = {}


@dataclass(frozen=True, eq=False)
class BatchSetup:
    """Settings that all frames of a batch share.

    ``folder`` is the session's; paths in messages are relative to it. ``calibration`` is that of the session, if any.
    ``rig`` has the session's camera, or both of a stereo session.
    """

    instrument: Instrument
    rig: Rig
    config: EstimateConfig
    arm: Arm = "classic"
    folder: Path = Path()
    segment: SegmentSettings = field(default_factory=SegmentSettings)
    calibration: SessionCalibration | None = None


Packed = tuple[bytes, str, int]
"""A pickled setup, and host and process in which it was pickled."""


def packed_setup(setup: BatchSetup) -> Packed:
    """Pickle a setup."""
    return pickle.dumps(setup, protocol=pickle.HIGHEST_PROTOCOL), *_here()


def prepare_instrument(instrument: Instrument) -> Body:
    """Build an instrument's scenes, once in each process for all instruments of the same content."""
    key = instrument_digest(instrument)
    if key not in _prepared:
        _prepared.clear()  # one at a time: a process that works for several sessions does so one after the other
        _prepared[key] = prepare(instrument)
    return _prepared[key]


def prepared_body(key: str) -> Body:
    """Return the scenes of the instrument with a digest, which was prepared in this process."""
    return _prepared[key]


def prepare_process(packed: Packed) -> None:
    """Unpickle a setup and build its scenes, before the first frame."""
    _unpacked(packed)


def run_task(packed: Packed, files: FrameFiles) -> FrameOutcome:
    """Estimate one frame; never raises."""
    return estimated(*_unpacked(packed), files)


def estimated(setup: BatchSetup, body: Body, files: FrameFiles) -> FrameOutcome:
    """Read and estimate one frame, whose result has failed where that is not possible; never raises."""
    try:
        frame = read_frame(files, setup.rig)
        frame = replace(frame, notes=tuple(relative_text(setup.folder, note) for note in frame.notes))
        method = FrameMethod(setup.arm, setup.config, setup.calibration, setup.segment, hints_of(files))
        return outcome_of(files, frame, body, method)
    except DvrkCmaesError as error:
        reason = str(error)
    except MemoryError:
        reason = "out of memory: try fewer workers, or a smaller image"
    except Exception as error:  # an error in one frame must not end the batch
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = f"internal error, {type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}"
    return failed_outcome(setup, files, reason)


def failed_outcome(setup: BatchSetup, files: FrameFiles, reason: str) -> FrameOutcome:
    """Return the outcome of a frame that has no pose, for a reason."""
    result = Result.failed(
        files.name,
        relative_text(setup.folder, reason),
        files.readings,
        **setup.instrument.stated,
        warnings=files.notes,
        remarks=setup.rig.remarks,
        time=files.time,
        seed=setup.config.seed,
        config={**setup.config.as_dict(), "instrument": setup.instrument.describe_limits(setup.arm)},
    )
    drawing = draw_failed_frame(result, files)
    return FrameOutcome(result, None if drawing is None else encoded_image("overlay.jpg", drawing))


def hints_of(files: FrameFiles) -> Hints | None:
    """Return the prompts of a frame for its segmentation; None without any."""
    return None if files.prompts is None else hints_within(files.prompts, files.crop)


def relative_text(folder: Path, text: str) -> str:
    """Return a text on one line with paths relative to the session's folder, the same wherever that folder lies."""
    return " ".join(text.replace(f"{folder}{os.sep}", "").splitlines())


def _unpacked(packed: Packed) -> tuple[BatchSetup, Body]:
    """Return a setup and its body, which are made once in each process."""
    with _unpacking:
        return _made(packed)


@functools.lru_cache(maxsize=2)
def _made(packed: Packed) -> tuple[BatchSetup, Body]:
    data, *home = packed
    if tuple(home) != _here():
        limit_library_threads()
    setup: BatchSetup = pickle.loads(data)
    return setup, prepare_instrument(setup.instrument)


def _here() -> tuple[str, int]:
    return socket.gethostname(), os.getpid()
