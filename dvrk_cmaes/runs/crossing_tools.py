"""Frames of several arms whose tools meet, once every arm was solved: tools that are in front are solved again.

A tool is first solved without the pixels of the others. Where the poses tell that it is in front of another one, that
one's pixels are background. The results say in ``other_tools`` where the others are. A tool's result is written with it
only when it need not be solved again, or after it was: so an interrupted run goes on where it ended.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Final

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.frames.tool_frames import with_start
from dvrk_cmaes.io.output import output
from dvrk_cmaes.io.short_text import natural
from dvrk_cmaes.pose.depth_order import OPPOSITE, place_of_other
from dvrk_cmaes.results.result import Place, Result
from dvrk_cmaes.runs.base_agreement import by_itself
from dvrk_cmaes.runs.batch import BatchSummary, Workers, finish, outcomes, summarize_shard
from dvrk_cmaes.runs.frame import as_calibrated
from dvrk_cmaes.runs.output import COMMAND, update_result, write_outcome
from dvrk_cmaes.runs.summary import timing_of
from dvrk_cmaes.silhouette.prepare import prepare

Places = dict[str, dict[str, Place]]
"""Where the other tools of a frame are, by arm, as seen by the tool of each arm."""

_UNSOLVED: Final = "other tools behind this one as background: "


def solve_crossing(batches: Mapping[str, BatchSummary], workers: Workers) -> dict[str, BatchSummary]:
    """Solve the frames again in which a tool is in front of another one, and return the batches with their new results.

    ``batches`` are those of a session's arms, by arm. Results, tables and pages are written anew where a frame was
    solved again. Errors as `run_batch`.
    """
    names = sorted({name for batch in batches.values() for name in batch.results}, key=natural)
    places = {name: _places_in_frame(name, batches) for name in names}
    asked = {
        arm: [
            replace(by_itself(batch.results[name]), other_tools=of_arms[arm])
            for name, of_arms in places.items()
            if arm in of_arms and batch.results[name].other_tools != of_arms[arm]
        ]
        for arm, batch in batches.items()
    }
    finished = {arm: _with_places(batch, asked[arm]) for arm, batch in batches.items()}
    for arm, batch in finished.items():
        again = [result for result in asked[arm] if "behind" in result.other_tools.values()]
        if again and not workers.stop.is_set():
            finished[arm] = _solved_again(batch, again, workers)
        elif again:
            finished[arm] = replace(batch, interrupted=True)
    return finished


def _places_in_frame(name: str, batches: Mapping[str, BatchSummary]) -> Places:
    """Find where the tools of the arms that have a pose in a frame are; empty with fewer than two of them.

    What a result says already is kept, since the pose may be one that was found with it.
    """
    arms = [arm for arm, batch in batches.items() if _has_pose(batch, name)]
    places: Places = {arm: {} for arm in arms} if len(arms) > 1 else {}
    for arm, other in combinations(places, 2):
        first, second = batches[arm].results[name], batches[other].results[name]
        if other in first.other_tools:
            places[arm][other] = first.other_tools[other]
        elif arm in second.other_tools:
            places[arm][other] = OPPOSITE[second.other_tools[arm]]
        else:
            places[arm][other] = _place(name, batches[arm], batches[other])
        places[other][arm] = OPPOSITE[places[arm][other]]
    return places


def _has_pose(batch: BatchSummary, name: str) -> bool:
    """Whether a frame is one of a batch's, and has a mask and a pose."""
    result, files = batch.results.get(name), batch.frames.get(name)
    return result is not None and result.camera_from_root is not None and files is not None and files.has_mask


def _place(name: str, first: BatchSummary, second: BatchSummary) -> Place:
    """Return where the second of two arms' tools is in a frame, as seen by the first; unclear if it cannot be read."""
    try:
        views = _views(first, name), _views(second, name)
    except DvrkCmaesError:
        return "unclear"
    return place_of_other(
        (first.results[name], second.results[name]),
        (prepare(first.setup.instrument), prepare(second.setup.instrument)),
        views,
    )


def _views(batch: BatchSummary, name: str) -> tuple[SeenView, ...]:
    """Read the views of a frame, without images, with the camera with which it was solved."""
    data = read_frame(batch.frames[name].changed(image=None), batch.setup.rig)
    return as_calibrated(data, batch.setup.calibration).views


def _with_places(batch: BatchSummary, asked: Sequence[Result]) -> BatchSummary:
    """Write where the others are to the results of a batch that are not solved again."""
    results = dict(batch.results)
    with output(batch.folder, COMMAND):
        for result in asked:
            if "behind" not in result.other_tools.values():
                results[result.frame] = replace(results[result.frame], other_tools=result.other_tools)
                update_result(batch.folder, result.frame, other_tools=result.other_tools)
    return replace(batch, results=results)


def _solved_again(batch: BatchSummary, starts: Sequence[Result], workers: Workers) -> BatchSummary:
    """Solve frames of a batch again from their results, and write what is better; tables and page are made anew.

    A frame that cannot be solved again keeps its result.
    """
    started, done = time.monotonic(), 0
    first = {start.frame: start for start in starts}
    todo = [with_start(batch.frames[name], start) for name, start in first.items()]
    workers.progress.on_start(len(todo), [])
    with output(batch.folder, COMMAND):
        for outcome in outcomes(batch.setup, todo, workers):
            result = outcome.result
            if result.status == "failed":
                start = first[result.frame]
                unused = [*start.unused, _UNSOLVED + result.reasons[0]]
                update_result(batch.folder, result.frame, unused=unused, other_tools=start.other_tools)
            else:
                write_outcome(batch.folder, outcome)
            done += 1
            workers.progress.on_frame(outcome)
        run = batch.document["timing"]["run"]
        timing = run and timing_of(run["frames"], run["seconds"] + time.monotonic() - started)
        results = summarize_shard(batch.folder, timing) if batch.shard is not None else finish(batch.folder, timing)
    document = results.summary or {}
    return replace(
        batch, interrupted=done < len(todo), counts=document["counts"], document=document, results=results.frames
    )
