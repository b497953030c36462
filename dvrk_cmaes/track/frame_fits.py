"""Fits of a recording's frames near what its calibration predicts, as tasks that can run in any process.

A frame is fitted with the prediction as its prior, which gives the outline's terms about the fit. Its pose, smoothed
over the recording, is judged by the rules of `estimate --session`. In images without masks, these are found around the
silhouette that is expected, and once more around that of the fit where it lies elsewhere.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.frame_fit import (
    FOLLOWED,
    FROM_PREDICTION,
    FROM_TWO_STARTS,
    WHILE_RUNNING,
    FrameFit,
    OwnEstimate,
    fit_frame,
)
from dvrk_cmaes.calibration.session_frame import StoredView
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.seen_view import SeenView, overlap_of, shown_views
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.pose.doubts import reasons, silhouette_without_colours
from dvrk_cmaes.pose.terms.tips_term import Expected
from dvrk_cmaes.pose.views import FrameView, silhouette_of
from dvrk_cmaes.segment.regions import FINEST
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.image_masks import PASSES, SPREAD_OF_FIT, ColourModel, Colours, learned_colours, mask_around

_LEAST_SHOWN = 40  # px of mask, from which on a frame is fitted
_ANOTHER_START = 1.0  # standard deviations per parameter between two starts that are both tried


PredictedFrame = tuple[Callable[[], FrameData | None], Expected]
"""The function that reads a frame's data, and what the calibration expects of it."""


@dataclass(frozen=True, eq=False)
class MaskedFit:
    """The fit of the views of an image to masks, given or found by colours.

    ``masks`` (H, W) are those, by view, ``own`` is what the outlines are measured by. ``unsupported`` is the largest
    share of a silhouette about which a mask was found that has not the instrument's colours, ``seconds`` the time that
    the fit took.
    """

    views: tuple[FrameView, ...]
    fit: FrameFit
    own: OwnEstimate
    masks: Mapping[str, Bool]
    unsupported: float = 0.0
    seconds: float = 0.0

    @property
    def doubts(self) -> list[str]:
        """The reasons to doubt the masks that were found."""
        return reasons(silhouette_without_colours(self.unsupported))

    @property
    def holds(self) -> bool:
        """Whether the fit explains its masks, and these are not in doubt."""
        return self.fit.explains_mask and not self.doubts


StoredFit = tuple[tuple[StoredView, ...], MaskedFit]
"""The views of a frame, packed for other processes, and their fit, which has none."""


@dataclass(frozen=True, eq=False)
class ImageFitter:
    """Fits images near what is expected of them: with an instrument, and all settings.

    ``margin``, px, is taken off the masks. With ``colours`` of the views, by name, masks are found in
    the images of views that have none. ``lengths``, correlation lengths, px, of the contours of images before, by view,
    are given while images come: the fit is then found in few drawings.
    """

    body: Body
    config: EstimateConfig
    margin: float = 0.0
    colours: Colours | None = None
    lengths: Mapping[str, float] | None = None

    def fit(self, seen: Sequence[SeenView], expected: Expected, before: Float64 | None) -> MaskedFit | None:
        """Fit the views of an image; None if their masks show nothing.

        ``before`` (D,) is the deviation of the image before from its prediction, None without one. Masks are found
        about where the instrument is expected, and again about the fit where that lies elsewhere.
        """
        at = expected.mean if before is None else expected.mean.moved(before)
        fitted: MaskedFit | None = None
        last = list[Bool]()
        near = self.lengths is not None and before is not None
        for k in range(1 if near else _ROUNDS):
            masked, unsupported = tuple(seen), 0.0
            if self.colours is not None:
                drawn = [silhouette_of(at, view, self.body) for view in seen]
                if k and min(overlap_of(*pair) for pair in zip(last, drawn, strict=True)) > _SAME:
                    break
                spread, last = SPREAD_OF_FIT if k or near else _spread(expected, seen[0].camera), drawn
                masked, unsupported = _masked(seen, drawn, self.colours, spread, running=self.lengths is not None)
            shown = shown_views(masked)
            if max((int(np.count_nonzero(view.mask)) for view in shown), default=0) < _LEAST_SHOWN:
                return None
            views = tuple(FrameView.of(view, self.body, view.ignore, features=False) for view in shown)
            fit, own = self._fit_near(views, expected, before)
            at = fit.at
            fitted = MaskedFit(views, fit, own, {view.name: view.mask for view in masked if view.given}, unsupported)
            if self.colours is None:
                break
        return fitted

    def _fit_near(
        self, views: Sequence[FrameView], expected: Expected, before: Float64 | None
    ) -> tuple[FrameFit, OwnEstimate]:
        """Fit views with masks; returns the fit, and what its outlines are measured by."""
        starts, lengths, preset = [expected.mean], list[float](), FOLLOWED
        if before is not None:
            apart = float(np.sqrt(before @ expected.information @ before / len(before)))
            starts = [expected.mean.moved(before), *(starts if apart > _ANOTHER_START else ())]
        if self.lengths is not None:
            preset = FROM_PREDICTION if before is None else WHILE_RUNNING if len(starts) == 1 else FROM_TWO_STARTS
            lengths = [self.lengths.get(view.name, self.config.refine.outline.correlation) for view in views]
        return fit_frame(views, self.config, expected, starts, margin=self.margin, lengths=lengths, preset=preset)


_LONGEST = 640  # px, longer side of the images in which masks are found while they come
_ROUNDS = 3  # of masks and fits of a frame, at most
_SAME = 0.97  # intersection over union of the silhouettes of two rounds, from which on the mask is not found again
_LARGEST_SPREAD = 12.0  # px, of an outline that is expected
_REACH = 0.015  # m from the root, of the outline whose place depends on angles
_PREDICTED = 0.6  # intersection over union of a mask and a predicted silhouette, from which on colours are learned


def learn_task(
    body: Body, config: EstimateConfig, task: tuple[Callable[[], FrameData | None], Posed, Mapping[str, Bool]]
) -> dict[str, ColourModel]:
    """Learn the colours about masks that overlap the silhouette of a predicted pose well enough, by name of the view.

    A task has the function that reads a frame's images, where the instrument is predicted in them, and the masks
    (H, W), by view, that were found in them.
    """
    read, at, masks = task
    data, found = read(), {}
    for view in () if data is None else data.views:
        mask = masks.get(view.name)
        if view.image is None or mask is None or overlap_of(silhouette_of(at, view, body), mask) < _PREDICTED:
            continue
        model = learned_colours(view.image, mask, view.ignore)
        if model is not None:
            found[view.name] = model
    return found


def fit_block(
    body: Body, config: EstimateConfig, frames: Sequence[PredictedFrame], *, margin: float, colours: Colours | None
) -> list[StoredFit | None]:
    """Fit consecutive frames, each from its prediction and from that changed as the frame before was.

    ``margin`` and ``colours`` are as of `ImageFitter`. None stands for a frame whose masks or images show nothing of
    the instrument where it is expected.
    """
    fitter, found = ImageFitter(body, config, margin, colours), list[StoredFit | None]()
    before: Float64 | None = None
    for read, expected in frames:
        started, data, fitted = time.perf_counter(), read(), None
        if data is not None:
            fitted = fitter.fit(data.views, expected, before)
        before = None
        if fitted is None:
            found.append(None)
            continue
        alone = replace(fitted, views=(), masks={}, seconds=time.perf_counter() - started)
        found.append((tuple(map(StoredView.of, fitted.views)), alone))
        if fitted.holds:
            before = fitted.fit.at.minus(expected.mean)
    return found


def _masked(
    seen: Sequence[SeenView], drawn: Sequence[Bool], colours: Colours, spread: float, *, running: bool
) -> tuple[tuple[SeenView, ...], float]:
    """Return views with masks found around silhouettes, and the largest share of one that is unsupported."""
    views, shares = [], [0.0]
    for view, silhouette in zip(seen, drawn, strict=True):
        model = colours.get(view.name)
        if view.given or view.image is None or model is None:
            views.append(replace(view, image=None))
            continue
        how = (1, _LONGEST) if running else (PASSES, FINEST)
        found = mask_around(view.image, silhouette, model, view.ignore, spread, *how)
        mask, unsupported = (np.zeros_like(silhouette), 0.0) if found is None else found
        views.append(replace(view, mask=mask, given=True, image=None))
        shares.append(unsupported)
    return tuple(views), max(shares)


def _spread(expected: Expected, camera: Camera) -> float:
    """Return the standard deviation, px, of the outline that is expected."""
    covariance = np.linalg.inv(expected.information)
    along = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    turned = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1]) * _REACH**2
    depth = max(float(expected.mean.pose[2, 3]), 0.02)
    return min(camera.fx / depth * float(np.sqrt(along + turned)), _LARGEST_SPREAD)
