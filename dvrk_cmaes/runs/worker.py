"""One frame of a batch, in whatever process: from its files to the bytes of its result and overlay.

What all frames share is sent packed and unpacked once a process, where the instrument's Embree scenes are then built;
they cannot be sent. A frame never raises: what goes wrong becomes a ``failed`` result with its reason.
"""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import socket
import threading
import traceback
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
from threadpoolctl import threadpool_limits

from dvrk_cmaes._version import __version__
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.atomic import encoded_image, json_text
from dvrk_cmaes.results.paths import mask_path, overlay_path
from dvrk_cmaes.results.result import Result, Status
from dvrk_cmaes.runs.frame import draw_frame, estimate_frame
from dvrk_cmaes.segment.with_instrument import Segmenter, SegmentSettings
from dvrk_cmaes.silhouette import Body

_unpacking = threading.Lock()


@dataclass(frozen=True, eq=False)
class BatchSetup:
    """What the frames of a batch have in common.

    ``folder`` is the session's: messages name files from there. With a ``calibration`` frames start from what it says.
    """

    instrument: Instrument
    camera: Camera
    config: EstimateConfig
    arm: Arm = "classic"
    folder: Path = Path()
    segment: SegmentSettings = field(default_factory=SegmentSettings)
    calibration: SessionCalibration | None = None


@dataclass(frozen=True)
class PackedSetup:
    """A setup on its way to other processes, and the process that it comes from."""

    key: str
    data: bytes = field(repr=False, compare=False)
    home: tuple[str, int]

    @staticmethod
    def of(setup: BatchSetup) -> PackedSetup:
        """Pack a setup."""
        data = pickle.dumps(setup, protocol=pickle.HIGHEST_PROTOCOL)
        return PackedSetup(hashlib.sha256(data).hexdigest(), data, _here())


@dataclass(frozen=True)
class FrameOutcome:
    """A frame's result as the files that it will be: JSON, and unless it failed, the overlay's JPEG.

    ``mask`` is the PNG of a frame's that had none.
    """

    frame: str
    status: Status
    reasons: tuple[str, ...]
    seconds: float
    result: bytes = field(repr=False)
    overlay: bytes | None = field(repr=False)
    mask: bytes | None = field(default=None, repr=False)


def prepare_process(packed: PackedSetup) -> int:
    """Unpack a setup and build its scenes before the first frame comes; returns the process' id."""
    _unpacked(packed)
    return os.getpid()


def run_task(packed: PackedSetup, files: FrameFiles) -> FrameOutcome:
    """Do one frame."""
    setup, body = _unpacked(packed)
    try:
        return _outcome(*_estimated(setup, body, files))
    except DvrkCmaesError as error:
        reason = str(error)
    except MemoryError:
        reason = "out of memory: try fewer workers, or a smaller image"
    except Exception as error:  # One bad frame must not end a batch, whatever is wrong with it.
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = f"internal error, {type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}"
    return failed_outcome(setup, files, reason)


def failed_outcome(setup: BatchSetup, files: FrameFiles, reason: str) -> FrameOutcome:
    """Outcome of a frame that there is no pose of."""
    result = Result(
        frame=files.name,
        status="failed",
        reasons=(named_from(setup.folder, reason),),
        instrument=setup.instrument.name,
        root_link=setup.instrument.root_link,
        camera_from_root=None,
        joints={},
        readings=dict(files.readings),
        warnings=files.notes,
        seed=setup.config.seed,
        version=__version__,
        config=setup.config.as_dict(),
    )
    return _outcome(result, None)


def _estimated(setup: BatchSetup, body: Body, files: FrameFiles) -> tuple[Result, bytes, bytes | None]:
    data = read_frame(files, setup.camera, Segmenter(body, setup.config, setup.segment))
    data = replace(data, notes=tuple(named_from(setup.folder, note) for note in data.notes))
    result = estimate_frame(files, data, body, arm=setup.arm, config=setup.config, session=setup.calibration)
    drawing = draw_frame(result, files, data, body)
    mask = None if data.segmentation is None else encoded_image(mask_path(Path(), files.name), data.mask)
    return result, encoded_image(overlay_path(Path(), files.name), drawing), mask


def _outcome(result: Result, overlay: bytes | None, mask: bytes | None = None) -> FrameOutcome:
    document = json_text(result.to_dict()).encode()
    return FrameOutcome(result.frame, result.status, result.reasons, result.seconds, document, overlay, mask)


def named_from(folder: Path, text: str) -> str:
    """Name files from the session's folder, so that results are the same wherever it lies; on one line."""
    return " ".join(text.replace(f"{folder}{os.sep}", "").splitlines())


def _unpacked(packed: PackedSetup) -> tuple[BatchSetup, Body]:
    """Give a setup and its body, the same for all frames of a process."""
    with _unpacking:
        return _made(packed)


@functools.lru_cache(maxsize=2)
def _made(packed: PackedSetup) -> tuple[BatchSetup, Body]:
    if packed.home != _here():
        _one_thread()
    setup: BatchSetup = pickle.loads(packed.data)
    return setup, Body.prepare(setup.instrument)


def _here() -> tuple[str, int]:
    return socket.gethostname(), os.getpid()


@functools.cache
def _one_thread() -> threadpool_limits:
    """Keep the libraries of a worker's process to one thread: the processes are what uses the cores."""
    cv2.setNumThreads(1)
    return threadpool_limits(1)
