"""The HTML page of a followed recording, OUT/report.html, which needs no network.

It shows curves over time, what happened when, and small pictures, with one cursor for all. The page contains all of it:
numbers of 32 bits, and at most `track_pictures.MOST_PICTURES` pictures, however long the recording is.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.config import __version__
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.report.page_session import KeyFigure, counted_reasons
from dvrk_cmaes.report.page_template import render_template, write_rendered
from dvrk_cmaes.report.page_thumbnails import Thumbnail
from dvrk_cmaes.report.plots.track import Chart, track_charts
from dvrk_cmaes.report.track_events import DOUBTFUL, STATUSES, SWITCHED, TrackEvent, track_events
from dvrk_cmaes.report.track_pictures import HIGH, MEDIAN

PAGE: Final = "report.html"
_MOST_EVENTS: Final = 1000  # rows of the table


@dataclass(frozen=True, eq=False)
class FollowedRecording:
    """A followed recording of F frames, as its page shows it.

    rows : F lines of tracks.jsonl. session : name of the recording. instrument : name of the instrument.
    calibration : base, offsets and lag as they were found, or None. readings : at the images' times by joint, (F,) rad,
    NaN where there is none. residuals : distances of the masks' contours from the outlines by name, (F,) px, NaN where
    there is none. pictures : small pictures, by index of the frame. video : name of the overlay video beside the page;
    empty without one.
    """

    rows: Sequence[Mapping[str, Any]]
    session: str
    instrument: str
    calibration: SessionCalibration | None = None
    readings: Mapping[str, Float64] = field(default_factory=dict)
    residuals: Mapping[str, Float64] = field(default_factory=dict)
    pictures: Mapping[int, Thumbnail] = field(default_factory=dict)
    video: str = ""

    @property
    def times(self) -> Float64 | None:
        """Times of the frames from the first one on, (F,) s; None if the times of some are not known."""
        known = [row["time"] for row in self.rows]
        return None if None in known else np.array(known, dtype=np.float64) - known[0]


def write_track_page(out: Path, recording: FollowedRecording) -> Path:
    """Write OUT/report.html and return its path; errors as in `dvrk_cmaes.io.output.write_bytes`."""
    return write_rendered(out / PAGE, render_track_page(recording))


def render_track_page(recording: FollowedRecording) -> str:
    """Render the page of a recording of at least one frame."""
    rows, times = recording.rows, recording.times
    charts = track_charts(rows, times, recording.readings, recording.residuals)
    events = track_events(rows)
    counts = Counter(row["status"] for row in rows)
    return render_template(
        "track.html",
        scripts=("tiles.js", "track_plot.js", "track.js"),
        styles=("track.css",),
        rows=rows,
        times=times,
        recording=recording,
        version=__version__,
        statuses=[status for status in STATUSES if status in ("ok", "doubtful", "lost") or counts[status]],
        counts=counts,
        figures=list(_figures(recording, events)),
        charts=charts,
        events=events[:_MOST_EVENTS],
        more_events=max(len(events) - _MOST_EVENTS, 0),
        switched=SWITCHED,
        warnings=() if recording.calibration is None else recording.calibration.warnings,
        reasons=counted_reasons([row["reasons"] for row in rows]),
        data=_data(recording, charts, events),
    )


def _figures(recording: FollowedRecording, events: Sequence[TrackEvent]) -> Iterator[KeyFigure]:
    """Yield the key figures of a recording."""
    rows, times = recording.rows, recording.times
    good = sum(row["status"] == "ok" for row in rows)
    length = "" if times is None else f" in {times[-1]:.1f} s"
    yield KeyFigure("Frames ok", f"{100 * good / len(rows):.1f} %", f"{good:,} of {len(rows):,}{length}")
    gaps = [event for event in events if event.kind not in (SWITCHED, DOUBTFUL)]
    longest = max(gaps, key=lambda event: event.frames, default=None)
    note = "followed in every frame"
    if longest is not None:
        many = "" if longest.frames == 1 else "s"
        note = f"longest: {longest.frames} frame{many}, from {rows[longest.first]['frame']}"
    yield KeyFigure("Lost", {0: "never", 1: "once"}.get(len(gaps), f"{len(gaps)} times"), note)
    switches = sum(event.kind == SWITCHED for event in events)
    yield KeyFigure("Modes switched", str(switches), "to another pose with nearly the same silhouette")
    yield from _residual(rows, recording.residuals)
    spread = [row["std"]["tip_mm"] for row in rows if row["std"] and row["std"].get("tip_mm") is not None]
    if spread:
        note = f"95 % of the frames within {np.percentile(spread, 95):.2f} mm"
        yield KeyFigure("Tips, standard deviation, median", f"{np.median(spread):.2f} mm", note)
    seconds = 1e3 * np.array([row["seconds"] for row in rows])
    searched = sum(bool(row.get("searched")) for row in rows)
    note = f"99 % within {np.percentile(seconds, 99):.0f} ms; {searched} global searches"
    yield KeyFigure("Time a step, median", f"{np.median(seconds):.0f} ms", note)
    yield from _base(rows)
    lag = None if recording.calibration is None else recording.calibration.lag
    if lag is not None:
        yield KeyFigure("Lag", lag.text, lag.describe())


def _base(rows: Sequence[Mapping[str, Any]]) -> Iterator[KeyFigure]:
    """Yield the key figure of the arm's base where it was found while following."""
    known = [row.get("base") for row in rows]
    last = known[-1]
    if last is None:
        return
    first = next((k for k, each in enumerate(known) if each is not None and each["used"]), None)
    value = "not known" if first is None else f"from frame {rows[first]['frame']}"
    far = "" if last["tip_mm"] is None else f", tips to {last['tip_mm']:.1f} mm by the last solution"
    yield KeyFigure("Base known", value, f"{last['keyframes']} keyframes at the end, {last['solved']} solved{far}")


def _residual(rows: Sequence[Mapping[str, Any]], residuals: Mapping[str, Float64]) -> Iterator[KeyFigure]:
    """Yield the key figure of the distances between masks and outlines or, without masks, of those of edges."""
    known = [residuals[name][np.isfinite(residuals[name])] for name in (MEDIAN, HIGH) if name in residuals]
    if len(known) == 2 and len(known[0]):
        half, most = (f"{np.median(values):.1f} px" for values in known)
        yield KeyFigure("Mask to outline, median", half, f"95 % of the contour within {most}, in half of the frames")
        return
    used = [row["residual_px"] for row in rows if row.get("residual_px") is not None]
    if used:
        note = "standard deviation of the image's edges that were used, in half of the frames at most this"
        yield KeyFigure("Edges to outline, median", f"{np.median(used):.1f} px", note)


def _data(recording: FollowedRecording, charts: Sequence[Chart], events: Sequence[TrackEvent]) -> dict[str, Any]:
    """Return what the page's script draws: plain values, with curves as base64 of little-endian 32-bit floats."""
    rows, times = recording.rows, recording.times
    texts = list(dict.fromkeys(reason for row in rows for reason in row["reasons"]))
    place = {reason: k for k, reason in enumerate(texts)}
    return {
        "frames": [row["frame"] for row in rows],
        "times": None if times is None else _encoded(times, "<f4"),
        "statuses": STATUSES,
        "status": _encoded([STATUSES.index(row["status"]) for row in rows], "u1"),
        "texts": texts,
        "reasons": {k: [place[reason] for reason in row["reasons"]] for k, row in enumerate(rows) if row["reasons"]},
        "events": [[event.kind, event.first, event.back] for event in events],
        "charts": {
            chart.name: {
                "digits": chart.digits,
                "curves": [
                    {"colour": curve.colour, "faint": curve.faint, "values": _encoded(curve.values, "<f4")}
                    for curve in chart.curves
                ],
            }
            for chart in charts
        },
    }


def _encoded(values: Sequence[int] | NDArray[Any], kind: str) -> str:
    """Encode numbers of a type, such as ``<f4``, as base64."""
    return base64.b64encode(np.asarray(values).astype(kind).tobytes()).decode("ascii")
