"""The page of a followed recording, OUT/report.html: figures, its pictures to play, curves, and what happened when."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.config import __version__
from dvrk_cmaes.draw.track_overlay import draw_outlines
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.short_text import counted
from dvrk_cmaes.report.curves import Chart, Curve
from dvrk_cmaes.report.page import calibration_part
from dvrk_cmaes.report.template import Entry, KeyFigure, Page, Part, Picture, Player, counted_reasons, webp
from dvrk_cmaes.results.tracked import TrackView

PAGE: Final = "report.html"
MOST_PICTURES: Final = 160
_WIDTH: Final = 640  # px, of a picture of a view
_QUALITY: Final = 35  # of WebP
_STATUSES: Final = ("ok", "doubtful", "lost")
_MOST_EVENTS: Final = 200


@dataclass(frozen=True)
class TrackEvent:
    """A stretch of frames of one status that is not ok.

    status : of its frames. first : index of its first frame. frames : their number. reason : of the first frame.
    """

    status: str
    first: int
    frames: int
    reason: str


@dataclass(eq=False)
class FollowedRecording:
    """A followed recording of F frames, as its page shows it; what is drawn of them is added one after the other.

    rows : F lines of tracks.jsonl. session : name of the recording. instrument : name of the instrument.
    calibration : base, offsets and lag as they were found, or None. readings : at the images' times by joint, (F,) rad,
    NaN where there is none. overlaps : IoU of mask and silhouette, (F,), NaN where there is none. pictures : small
    pictures as ``data:`` addresses, by index of the frame. video : name of the overlay video in the page's folder;
    empty without one. warnings : those of the session's files.
    """

    rows: Sequence[Mapping[str, Any]]
    session: str
    instrument: str
    calibration: SessionCalibration | None = None
    readings: Mapping[str, Float64] = field(default_factory=dict)
    overlaps: Float64 = field(default_factory=lambda: np.zeros(0))
    pictures: dict[int, str] = field(default_factory=dict)
    video: str = ""
    warnings: Sequence[str] = ()

    def __post_init__(self) -> None:
        if not len(self.overlaps):
            self.overlaps = np.full(len(self.rows), np.nan)
        self._chosen = frozenset(chosen_frames(self.rows))

    def add(self, number: int, views: Sequence[TrackView]) -> None:
        """Take what is needed of the frame of an index: the overlap in its views, and a picture of them.

        Parameters
        ----------
        number
            Index of the frame.
        views
            What was seen in it.
        """
        pairs = [(v.mask, v.silhouette) for v in views if v.mask is not None and v.silhouette is not None]
        union = sum(int((mask | silhouette).sum()) for mask, silhouette in pairs)
        if union:
            self.overlaps[number] = sum(int((mask & silhouette).sum()) for mask, silhouette in pairs) / union
        if number in self._chosen:
            self.pictures[number] = webp(draw_outlines(views), len(views) * _WIDTH, _QUALITY)

    @property
    def times(self) -> Float64:
        """Times of the frames from the first one on, (F,) s; their numbers if the times of some are not known."""
        known = [row["time"] for row in self.rows]
        return np.arange(len(known), dtype=np.float64) if None in known else np.array(known, np.float64) - known[0]

    @property
    def timed(self) -> bool:
        """Whether the times of all frames are known."""
        return all(row["time"] is not None for row in self.rows)


def chosen_frames(rows: Sequence[Mapping[str, Any]], most: int = MOST_PICTURES) -> list[int]:
    """Choose the frames that get a picture: those at which something happened first, then others at equal distances.

    Of more events than half of the pictures, the worst count.
    """
    places = sorted({event.first for event in track_events(rows)[: most // 2]})
    even = np.linspace(0, len(rows) - 1, min(len(rows), most - len(places))).round().astype(int).tolist()
    return sorted({*places, *even})


def track_events(rows: Sequence[Mapping[str, Any]]) -> list[TrackEvent]:
    """List what happened in a recording, given by its lines of tracks.jsonl: the worst first, then the longest."""
    found: list[TrackEvent] = []
    for status, stretch in groupby(range(len(rows)), lambda k: str(rows[k]["status"])):
        first, *more = stretch
        if status != "ok":
            found.append(TrackEvent(status, first, 1 + len(more), next(iter(rows[first]["reasons"]), "")))
    return sorted(found, key=lambda event: (-_STATUSES.index(event.status), -event.frames, event.first))


def track_page(recording: FollowedRecording) -> Page:
    """Return the page of a recording of at least one frame."""
    rows, events, times = recording.rows, track_events(recording.rows), recording.times
    counts = Counter(row["status"] for row in rows)
    numbers = list(recording.pictures)
    entries = []
    for event in events[:_MOST_EVENTS]:
        row, last = rows[event.first], rows[event.first + event.frames - 1]
        stretch = counted(event.frames, "frame") + (f", to {last['frame']}" if event.frames > 1 else "")
        when = f"at {times[event.first]:.2f} s: " if recording.timed else ""
        pictures = [Picture(recording.pictures[event.first])] if event.first in recording.pictures else []
        seek = numbers.index(event.first) if pictures else None
        reasons = [event.reason] if event.reason else []
        entries.append(Entry(row["frame"], event.status, pictures, [f"{when}{stretch}"], reasons, seek=seek))
    notes = [f"{len(events) - _MOST_EVENTS} more places to look at."] if len(events) > _MOST_EVENTS else []
    own = {event.first for event in events[:_MOST_EVENTS]}  # whose pictures the player takes from their entries
    player = Player(
        [rows[k]["frame"] for k in numbers],
        [round(float(times[k]), 3) for k in numbers],
        ["" if k in own else picture for k, picture in recording.pictures.items()],
        [rows[k]["status"] for k in numbers],
        recording.video,
    )
    return Page(
        "A followed recording",
        f"{recording.session} · {counted(len(rows), 'frame')} of {recording.instrument} · dvrk-cmaes {__version__}",
        {status: counts[status] for status in _STATUSES},
        alerts=[*recording.warnings, *(() if recording.calibration is None else recording.calibration.warnings)],
        notes=notes,
        figures=list(_figures(recording, events)),
        reasons=counted_reasons(row["reasons"] for row in rows),
        first=None if recording.calibration is None else calibration_part(recording.calibration),
        parts=[Part("Over time", charts=track_charts(recording))],
        entries=entries,
        heading="Places to look at, the worst first",
        player=player if numbers else None,
    )


def _figures(recording: FollowedRecording, events: Sequence[TrackEvent]) -> Iterator[KeyFigure]:
    """Yield the key figures of a recording."""
    rows = recording.rows
    good = sum(row["status"] == "ok" for row in rows)
    length = f" in {recording.times[-1]:.1f} s" if recording.timed else ""
    yield KeyFigure("Frames ok", f"{100 * good / len(rows):.1f} %", f"{good:,} of {len(rows):,}{length}")
    gaps = [event for event in events if event.status == "lost"]
    note = "followed in every frame"
    if gaps:
        longest = max(gaps, key=lambda event: event.frames)
        note = f"longest: {counted(longest.frames, 'frame')}, from {rows[longest.first]['frame']}"
    yield KeyFigure("Lost", {0: "never", 1: "once"}.get(len(gaps), f"{len(gaps)} times"), note)
    overlaps = recording.overlaps
    if np.isfinite(overlaps).any():
        worst = int(np.nanargmin(overlaps))
        note = f"lowest {overlaps[worst]:.3f} ({rows[worst]['frame']})"
        yield KeyFigure("Overlap (IoU), median", f"{np.nanmedian(overlaps):.3f}", note)
    spread = _column(rows, "std", "tip_mm")
    if np.isfinite(spread).any():
        note = f"95 % of the frames within {np.nanpercentile(spread, 95):.2f} mm"
        yield KeyFigure("Tips, standard deviation, median", f"{np.nanmedian(spread):.2f} mm", note)
    seconds = 1e3 * _column(rows, "seconds")
    searched = sum(bool(row.get("searched")) for row in rows)
    note = f"99 % within {np.percentile(seconds, 99):.0f} ms; {searched} global searches"
    yield KeyFigure("Time a step, median", f"{np.median(seconds):.0f} ms", note)
    if (last := rows[-1].get("base")) is not None:
        first = next((row["frame"] for row in rows if row.get("base") and row["base"]["used"]), None)
        far = "" if last["tip_mm"] is None else f", tips to {last['tip_mm']:.1f} mm by the last solution"
        note = f"{last['keyframes']} keyframes at the end, {last['solved']} solved{far}"
        yield KeyFigure("Base known", "not known" if first is None else f"from frame {first}", note)


def track_charts(recording: FollowedRecording) -> list[Chart]:
    """Chart a recording over time, or over its frames: joints, offsets, tips, overlap and errors."""
    rows, times = recording.rows, recording.times
    across = "time, s" if recording.timed else "frame"
    joints = list(dict.fromkeys(name for row in rows for name in row["joints"]))
    offsets = list(dict.fromkeys(name for row in rows for name in row.get("offsets") or {}))
    colours = {name: k for k, name in enumerate(dict.fromkeys([*joints, *offsets]))}

    def curve(name: str, y: Float64, *, faint: bool = False) -> Curve:
        return Curve(name, times, y, colour=colours.get(name), faint=faint)

    found = [curve(name, np.degrees(_column(rows, "joints", name))) for name in joints]
    read = [curve(k, np.degrees(read), faint=True) for k, read in recording.readings.items() if k in joints]
    tips = 1e3 * np.array([np.mean(row["tips"], axis=0) if row["tips"] else [np.nan] * 3 for row in rows])
    middle = np.nanmedian(tips, axis=0) if np.isfinite(tips).any() else np.zeros(3)
    known = {name: np.degrees(_column(rows, "offsets", name)) for name in offsets}
    off, std = {axis: tips[:, k] - middle[k] for k, axis in enumerate("xyz")}, _column(rows, "std", "tip_mm")
    charts = [
        ("Offsets", "deg", known, "True = reading + offset, as it was known at the time.", 0.0),
        ("Overlap of mask and pose", "IoU", {"": recording.overlaps}, "", 0.02),
        ("Tips in the camera", "mm from the median", off, "Mean of the tips: x right, y down, z forward.", 0.0),
        ("Standard deviation of the tips", "mm", {"": std}, "", 0.0),
    ]
    return [
        Chart("Joints", across, "deg", [*found, *read], "Found, and faintly as the robot read them.", seeks=True),
        *(
            Chart(title, across, up, [curve(*item) for item in own.items()], note, least=least, seeks=True)
            for title, up, own, note, least in charts
        ),
    ]


def _column(rows: Sequence[Mapping[str, Any]], *keys: str) -> Float64:
    """Return the values (F,) at keys in rows, one within the other; NaN where there is none."""
    values = np.full(len(rows), np.nan)
    for k, row in enumerate(rows):
        value: Any = row
        for key in keys:
            value = None if value is None else value.get(key)
        values[k] = np.nan if value is None else value
    return values
