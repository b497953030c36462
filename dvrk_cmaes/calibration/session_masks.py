"""What a session tells of the errors that its masks share, as it is stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration.lasting_estimate import LastingEstimate
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number


@dataclass(frozen=True)
class Margin:
    """The margin by which all masks of a view are too wide, its standard deviation, and whether it is taken off, px."""

    px: float
    std_px: float
    applied: bool


@dataclass(frozen=True)
class ViewMargin(Document):
    """The margin of a further view's masks, px, as that of the first one in `SessionMasks`."""

    view: str
    margin_px: Number
    std_margin_px: Number
    applied: bool


@dataclass(frozen=True)
class SessionMasks(Document):
    """What a session's frames tell of the errors that its masks share.

    margin_px : by how much the masks are too wide all round; negative if too narrow. std_margin_px : its standard
    deviation. applied : whether the session was solved with masks less this margin. In a session of several views these
    are of the first one, and ``further_views`` has those of the others.
    side_px : standard deviation of the error of a side of the shaft as a whole, which lasts from frame to frame, px.
    std_side_px : its standard deviation. lasting_seconds, std_lasting_seconds : the time in which the correlation of
    these errors falls to 37 %, s; None where the times of the frames are not known.
    """

    margin_px: Number
    std_margin_px: Number
    applied: bool
    further_views: tuple[ViewMargin, ...] = ()
    side_px: Number | None = None
    std_side_px: Number | None = None
    lasting_seconds: Number | None = None
    std_lasting_seconds: Number | None = None

    @classmethod
    def of(cls, margins: Sequence[tuple[str, Margin]], lasting: LastingEstimate | None) -> SessionMasks:
        """State the margins of the views, of which there is at least one, and what lasts from frame to frame."""
        (_, first), *others = margins
        further = tuple(ViewMargin(view, margin.px, margin.std_px, margin.applied) for view, margin in others)
        stated = cls(first.px, first.std_px, first.applied, further)
        if lasting is None:
            return stated
        seconds = lasting.size.seconds if lasting.timed else None
        return cls(
            first.px,
            first.std_px,
            first.applied,
            further,
            side_px=lasting.side_px,
            std_side_px=lasting.side_px * lasting.log_std_scale,
            lasting_seconds=seconds,
            std_lasting_seconds=None if seconds is None else seconds * lasting.log_std_seconds,
        )

    @property
    def taken_off(self) -> float:
        """Margin, px, that was taken off the masks of the first view."""
        return self.margin_px if self.applied else 0.0

    def taken_off_in(self, view: str) -> float:
        """Return the margin, px, that was taken off the masks of a view.

        Parameters
        ----------
        view
            Name of the view.
        """
        for other in self.further_views:
            if other.view == view:
                return other.margin_px if other.applied else 0.0
        return self.taken_off

    def describe(self) -> str:
        """Describe the margins that were taken off, or else the first one, and how long other errors last, in words."""
        margins = [Margin(self.margin_px, self.std_margin_px, self.applied)]
        margins += [Margin(one.margin_px, one.std_margin_px, one.applied) for one in self.further_views]
        named = zip(["", *(f" of the {one.view} eye" for one in self.further_views)], margins, strict=True)
        parts = [_in_words(name, margin) for name, margin in named]
        if self.side_px is not None:
            last = "" if self.lasting_seconds is None else f" and last {self.lasting_seconds:.1f} s"
            parts.append(f"errors of a side of the shaft are {self.side_px:.1f} px (std {self.std_side_px:.1f}){last}")
        return "; ".join(parts)


def margins_of(masks: SessionMasks | None, views: Sequence[str]) -> tuple[float, ...]:
    """Return the margins, px, that were taken off the masks of views, in their order; 0 if nothing is stated.

    Parameters
    ----------
    masks
        What a session states of its masks.
    views
        Names of the views.
    """
    return tuple(0.0 if masks is None else masks.taken_off_in(view) for view in views)


def _in_words(view: str, margin: Margin) -> str:
    """Describe the margin of a view in words."""
    than = "wide" if margin.px > 0 else "narrow"
    done = "taken off" if margin.applied else "left as they are"
    return f"masks{view} are {np.abs(margin.px):.2f} px (std {margin.std_px:.2f}) too {than} all round; {done}"
