"""Cases, of which measurements of accuracy are made: frames with their truth, and the results for them.

A case is a frame of a recording in memory, with what one or more views show of it, original or falsified. A run is the
result of a case. Each worker process uses one thread.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.frames.truth import FrameTruth
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import estimate_frame
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare
from measure.processes import in_processes
from measure.recordings import Recording, read_recordings

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
Item = TypeVar("Item")

ORIGINAL: Final = "honest"  # kind of a case that is not falsified
_CRASH: Final = "crash: "  # begins the reason of a result that ended with an unexpected exception


@dataclass(frozen=True, eq=False)
class Case:
    """Input of one estimate: the views of a frame, and its readings, rad and m.

    ``kind`` states what was falsified; it is ``ORIGINAL`` if nothing was. ``truth`` is that of the original frame.
    """

    recording: Recording
    frame: str
    kind: str
    data: FrameData
    readings: Mapping[str, float]
    truth: FrameTruth | None

    @property
    def session(self) -> str:
        """Name of the recording."""
        return self.recording.name

    @property
    def level(self) -> str:
        """Level of the recording."""
        return self.recording.level

    @property
    def mask(self) -> Bool:
        """Mask (H, W) of the first view."""
        return self.data.mask

    @property
    def camera(self) -> Camera:
        """Camera of the first view."""
        return self.data.camera

    @property
    def ignore(self) -> Bool | None:
        """Pixels (H, W) of the first view that count neither way."""
        return self.data.ignore

    def true(self, instrument: Instrument) -> Posed:
        """Return the true pose and joints; there must be a truth."""
        assert self.truth is not None
        joints = [self.truth.joints[name] for name in instrument.joint_names]
        return Posed(self.truth.camera_from_root, np.array(joints))

    def with_mask(self, mask: Bool) -> Case:
        """Return the case with another mask in its only view."""
        return replace(self, data=FrameData.of(mask, self.camera, self.ignore))

    def with_camera(self, camera: Camera) -> Case:
        """Return the case with another camera, for a mask of the same size."""
        return replace(self, data=self.data.with_camera(camera))

    def estimate(self, body: Body, config: EstimateConfig) -> Result:
        """Estimate the pose and the joints; errors as `dvrk_cmaes.estimate`."""
        return _estimate(self.frame, self.data, self.readings, body, config)


@dataclass(frozen=True, eq=False)
class Run:
    """Result of a case, features from which thresholds for doubt are chosen, and seconds of processor time.

    There are no features of several views, and no seconds of a result that was kept.
    """

    case: Case
    result: Result
    features: Mapping[str, float] = field(default_factory=dict)
    cpu_seconds: float = 0.0

    @property
    def failed(self) -> bool:
        """Whether the result has no pose."""
        return self.result.camera_from_root is None

    @property
    def status(self) -> str:
        """The result's status, or ``crashed`` after an unexpected exception."""
        return "crashed" if any(reason.startswith(_CRASH) for reason in self.result.reasons) else self.result.status

    @property
    def trusted(self) -> bool:
        """Whether the status is ok."""
        return self.status == "ok"

    @property
    def doubted(self) -> bool:
        """Whether the status is doubtful or failed; not for a crash."""
        return self.status in ("failed", "doubtful")

    @property
    def pose(self) -> Float64:
        """Estimated ``camera_from_root`` (4, 4)."""
        assert self.result.camera_from_root is not None
        return self.result.camera_from_root

    @property
    def covariance(self) -> Float64:
        """Covariance (6 + J, 6 + J) of small changes [t, r, joints] in the root's axes, m and rad."""
        assert self.result.covariance is not None
        return self.result.covariance

    def at(self, instrument: Instrument) -> Posed:
        """Return the estimated pose and joints."""
        return Posed(self.pose, np.array([self.result.joints[name] for name in instrument.joint_names]))


@dataclass(frozen=True)
class Measurement:
    """What is measured: the sessions' folders, the instrument in them, settings, numbers of frames and processes.

    ``frames`` is the largest number of each session, evenly spaced; None for all. With ``keep``, results are written to
    that folder, and those in it are reused.
    """

    folders: Sequence[str]
    source: str = "lnd"
    config: EstimateConfig = field(default_factory=EstimateConfig)
    frames: int | None = None
    workers: int = 2
    keep: Path | None = None

    @property
    def body(self) -> Body:
        """The prepared instrument."""
        return prepare(self.source)

    @property
    def instrument(self) -> Instrument:
        """The instrument."""
        return self.body.instrument

    def recordings(self) -> list[Recording]:
        """Read the recordings of all folders; InputError if two have the same name."""
        found: dict[str, Recording] = {}
        for folder in self.folders:
            for one in read_recordings(folder, self.instrument):
                if one.name in found:
                    raise InputError(f"{folder}: expected sessions of different names, got {one.name} twice")
                found[one.name] = one
        return list(found.values())

    def cases(
        self, *, truth: bool = True, base: bool = False, every_view: bool = False, images: bool = False
    ) -> list[Case]:
        """Read the frames of all recordings: their first view or every one, and the first one's image if it is used.

        A frame that cannot be used, for example with an empty mask where the instrument has left the view, is left out
        with a line on stderr.

        Raises
        ------
        InputError
            A session cannot be read, no frame of it can be used, two sessions have the same name, or with ``truth`` a
            frame or with ``base`` a session has no truth.
        """
        found = []
        for one in self.recordings():
            if base:
                _ = one.camera_from_base
            cases = [*_cases(one, self.frames, truth=truth, every_view=every_view, images=images)]
            if not cases:
                count = len(one.session.frames)
                raise InputError(f"{one.session.folder}: expected a frame that can be used, got none of {count}")
            found += cases
        return found

    def runs(self, cases: Sequence[Case] | None = None, label: str = "frames", *, truth: bool = True) -> list[Run]:
        """Estimate cases, by default the original ones, and return their results in the same order."""
        cases = self.cases(truth=truth) if cases is None else cases
        done: dict[int, Run] = {}
        for i, case in enumerate(cases):
            path = self._kept_path(case)
            if path is not None and path.exists():
                kept = json.loads(path.read_text(encoding="utf-8"))
                done[i] = Run(case, Result.from_dict(kept["result"]), kept["features"])
        left = [i for i in range(len(cases)) if i not in done]
        tasks = [(cases[i].frame, cases[i].data, cases[i].readings, self.source, self.config) for i in left]

        def on_done(count: int, found: tuple[dict[str, Any], dict[str, float], float]) -> None:
            case = cases[left[count]]
            done[left[count]] = Run(case, Result.from_dict(found[0]), *found[1:])
            path = self._kept_path(case)
            if path is not None:
                write_json(path, {"result": found[0], "features": found[1]})

        in_processes(_run, tasks, self.workers, label, on_done)
        return [done[i] for i in range(len(cases))]

    def _kept_path(self, case: Case) -> Path | None:
        """Return the path of a case's result in the folder ``keep``; None without that folder."""
        if self.keep is None:
            return None
        return self.keep / case.session / case.kind.replace(" ", "_") / f"{case.frame}.json"


def _cases(recording: Recording, frames: int | None, *, truth: bool, every_view: bool, images: bool) -> Iterable[Case]:
    """Yield the cases of a recording, at most ``frames``, as `Measurement.cases`."""
    session = recording.session
    files = session.frames
    if frames is not None and frames < len(files):
        files = tuple(files[i * len(files) // frames] for i in range(frames))
    for one in files:
        if truth and one.name not in session.truth.frames:
            raise InputError(f"{recording.golden}: expected the truth of frame {one.name}, got none")
        try:
            data = read_frame(one, session.rig if every_view else session.camera)
        except InputError as error:
            print(f"{recording.name}: frame {one.name} is left out: {error}", file=sys.stderr)
            continue
        views = (replace(view, image=view.image if images else None, keypoints=None) for view in data.views)
        seen = FrameData(tuple(views))
        yield Case(recording, one.name, ORIGINAL, seen, one.readings, session.truth.frames.get(one.name))


def _estimate(frame: str, data: FrameData, readings: Mapping[str, float], body: Body, config: EstimateConfig) -> Result:
    """Estimate a frame in memory."""
    return estimate_frame(FrameFiles(frame, None, readings=readings), data, body, FrameMethod("classic", config))


def _run(
    frame: str, data: FrameData, readings: Mapping[str, float], source: str, config: EstimateConfig
) -> tuple[dict[str, Any], dict[str, float], float]:
    """Estimate a frame in a worker process; return the result as JSON, the features and seconds of processor time."""
    body, single = prepare(source), replace(config, threads=1)
    failed = partial(
        Result.failed,
        frame,
        readings=readings,
        instrument=body.instrument.name,
        root_link=body.instrument.root_link,
    )
    started = time.process_time()
    try:
        result = _estimate(frame, data, readings, body, single)
    except InputError as error:
        return failed(str(error)).to_dict(), {}, 0.0
    except Exception as error:  # a defect: counted, so that the other cases are still run
        return failed(f"{_CRASH}{type(error).__name__}: {error}").to_dict(), {}, 0.0
    seconds = time.process_time() - started
    return result.to_dict(), {}, seconds


def grouped(items: Iterable[Item], name_of: Callable[[Item], str]) -> dict[str, list[Item]]:
    """Group items by a name, in order of appearance."""
    groups: dict[str, list[Item]] = {}
    for item in items:
        groups.setdefault(name_of(item), []).append(item)
    return groups


def by_session(runs: Iterable[Run]) -> dict[str, list[Run]]:
    """Group runs by their recording."""
    return grouped(runs, lambda run: run.case.session)


def by_level(items: Sequence[Item], level_of: Callable[[Item], str]) -> dict[str, list[Item]]:
    """Group items by their level, and all of them under ``all`` if there are several levels."""
    groups = grouped(items, level_of)
    return groups | ({"all": list(items)} if len(groups) > 1 else {})


def runs_by_level(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Group runs by the level of their recording, as `by_level`."""
    return by_level(runs, lambda run: run.case.level)


def session_frames(
    cases: Sequence[Case],
    results: Sequence[Result],
    *,
    names: Sequence[str] | None = None,
    times: Mapping[str, float] | None = None,
) -> list[SessionFrame]:
    """Return the frames of a calibration: cases with their results, by their own or other names, and image times, s."""
    named = [case.frame for case in cases] if names is None else names
    return [
        SessionFrame(name, case.data, replace(result, frame=name), time=(times or {}).get(name))
        for name, case, result in zip(named, cases, results, strict=True)
    ]
