"""What a session's frames tell of its cameras and its masks, beside the base, the readings' errors and the poses.

A change of the camera, what further views differ in from the file of the rig, and the margin of each view's masks are
each estimated from the outlines of all frames, linearised about the current fits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.constants import Constant, SessionOutlines
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.frame_task import Run
from dvrk_cmaes.calibration.lasting_errors import USUAL_SIZE, CommonErrors, LastingSize
from dvrk_cmaes.calibration.lasting_estimate import LastingEstimate
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.rig_estimate import ViewDifference, estimate_rig
from dvrk_cmaes.calibration.session_camera import (
    CameraChange,
    CameraCheck,
    check_camera,
    estimate_camera,
    file_deviations,
)
from dvrk_cmaes.calibration.session_masks import Margin, MaskMargin, SessionMasks, estimate_margin, margins_of
from dvrk_cmaes.calibration.session_rig import FEWEST, ViewRotation, changes_of
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.camera.rig import ViewChange
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Posed

Float64 = NDArray[np.float64]

_CAMERA_PASSES = 2  # linearisations of the outlines about the camera between two fits of the frames


@dataclass(frozen=True, eq=False)
class Imaging:
    """What is known of a session's cameras and masks.

    ``change`` (3,) is that of the camera, as of `changed`, None where the camera's file is used; ``rig`` what the
    further views differ in from the file; ``margins`` those of the views' masks by name, in the views' order, empty
    until they are estimated; ``lasting`` the size of the masks' errors that last, None until it is estimated.
    """

    change: Float64 | None = None
    rig: tuple[ViewRotation, ...] = ()
    margins: tuple[tuple[str, Margin], ...] = ()
    lasting: LastingEstimate | None = None

    @property
    def size(self) -> LastingSize:
        """Size of the masks' errors that last from frame to frame."""
        return USUAL_SIZE if self.lasting is None else self.lasting.size

    @property
    def masks(self) -> SessionMasks | None:
        """What is stated of errors that the masks share; None if their margin was not estimated."""
        return SessionMasks.of(self.margins, self.lasting) if self.margins else None

    @property
    def taken_off(self) -> float:
        """Margin, px, that is taken off the masks of the first view."""
        return 0.0 if self.masks is None else self.masks.taken_off

    def margins_of(self, stored: StoredFrame) -> tuple[float, ...]:
        """Return the margins, px, that are taken off the masks of a frame's views.

        Parameters
        ----------
        stored
            The frame.
        """
        return margins_of(self.masks, [view.name for view in stored.views])


@dataclass(frozen=True, eq=False)
class Estimated:
    """Cameras and masks that were estimated beside a calibration, which is the one with these.

    ``at`` are the poses of the N frames with them, None if nothing changed. ``changes`` are those of the further views,
    by name, ``undetermined`` texts about what the session does not determine.
    """

    imaging: Imaging
    calibration: Calibration
    at: Posed | None
    changes: dict[str, ViewChange] | None = None
    undetermined: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FittedSession:
    """N frames of a session with their current fits, from which cameras and masks are estimated.

    ``prior`` (K, K) is the information matrix of the calibration's prior, as in `solve`; ``stored`` are the frames'
    evidence, ``common`` the errors that the frames share; ``run`` applies a function to many tasks. ``imaging`` is what
    the fits were made with.
    """

    model: SessionModel
    prior: Float64
    config: SessionConfig
    fits: Sequence[FrameFit]
    stored: Sequence[StoredFrame]
    common: CommonErrors
    run: Run[Any, Any]
    imaging: Imaging

    def with_camera(self, calibration: Calibration, at: Posed) -> Estimated:
        """Estimate the change of the camera, and use it.

        Parameters
        ----------
        calibration, at
            The calibration and the frames' poses with the present change.
        """
        of_all = self.model, calibration, self.prior, self.config, at
        estimate = estimate_camera(*of_all, self.outlines(), passes=_CAMERA_PASSES)
        return Estimated(replace(self.imaging, change=estimate.change), estimate.calibration, estimate.at)

    @property
    def rig_outlines(self) -> SessionOutlines | None:
        """Outlines that tell what the further views differ in from the file; None without enough of them."""
        if not self.imaging.rig:
            return None
        used = [fit.explains_mask and stored.in_reference for fit, stored in self._fitted()]
        counts: dict[str, int] = {}
        for stored, counted in zip(self.stored, used, strict=True):
            for view in stored.views[1:] if counted else ():
                counts[view.name] = counts.get(view.name, 0) + 1
        turned = {name: change.rotation for name, change in changes_of(self.imaging.rig).items()}
        of_views = [
            ViewDifference(name, turned.get(name, np.zeros(3))) for name, count in counts.items() if count >= FEWEST
        ]
        views = [tuple(range(len(one.views))) if own else () for one, own in zip(self.stored, used, strict=True)]
        # each frame is taken to err by itself: what they share is the reason for the factor on standard deviations
        common = CommonErrors.none(len(self.stored), len(self.fits[0].slope))
        margin = MaskMargin(self.imaging.taken_off)
        constants = (self._camera(file_tells=self.imaging.change is None), margin, *of_views)
        return SessionOutlines(self.stored, views, self.run, common, constants) if of_views else None

    def with_rig(self, calibration: Calibration, at: Posed, outlines: SessionOutlines) -> Estimated:
        """Estimate what the further views differ in from the file beside rotations, and use what is clear.

        Parameters
        ----------
        calibration, at
            The calibration and the frames' poses with the rig as it is.
        outlines
            Those of `rig_outlines`.

        Raises
        ------
        InputError
            The lens distortion with the estimated focal length is not one-to-one over the image.
        """
        estimate = estimate_rig(self.model, calibration, self.prior, at, outlines, self.imaging.rig)
        imaging = replace(self.imaging, rig=estimate.views)
        if not estimate.moved:
            return Estimated(imaging, calibration, None, undetermined=estimate.untold)
        return Estimated(imaging, estimate.calibration, estimate.at, dict(estimate.changes), estimate.untold)

    def with_margins(self, calibration: Calibration, at: Posed) -> Estimated:
        """Estimate the margin of each view's masks, and take it off if it is clear.

        Parameters
        ----------
        calibration, at
            The calibration and the frames' poses with whole masks.
        """
        names = list(dict.fromkeys(view.name for stored in self.stored for view in stored.views))
        of_all = self.model, calibration, self.prior, at
        found = [estimate_margin(*of_all, self.outlines(name, file_tells=True)) for name in names]
        margins = tuple((name, margin) for name, (margin, _, _) in zip(names, found, strict=True))
        imaging = replace(self.imaging, margins=margins)
        for margin, with_margin, moved in found:
            if margin.applied:
                return Estimated(imaging, with_margin, moved)
        return Estimated(imaging, calibration, None)

    def check_camera(self, calibration: Calibration) -> CameraCheck:
        """Test whether the frames contradict the camera file, as `check_camera` of a session's camera.

        Parameters
        ----------
        calibration
            The calibration that belongs to the fits.
        """
        at = Posed.stacked(fit.at for fit in self.fits)
        return check_camera(
            self.model, calibration, self.prior, self.config, at, self.outlines(), applied=self.imaging.change
        )

    def outlines(self, view: str | None = None, *, file_tells: bool = False) -> SessionOutlines:
        """Return the outlines of all frames in a view, as functions of the camera and the margin.

        Parameters
        ----------
        view
            Name of the view; by default that of the reference camera.
        file_tells
            Whether the camera's file counts as a measurement.
        """
        name = self._reference if view is None else view
        numbers = [stored.number_of(name) if fit.explains_mask else None for fit, stored in self._fitted()]
        views = [() if number is None else (number,) for number in numbers]
        masks = self.imaging.masks
        margin = MaskMargin(0.0 if masks is None else masks.taken_off_in(name))
        constants = self._camera(file_tells=file_tells), margin
        return SessionOutlines(self.stored, views, self.run, self.common, constants)

    def _camera(self, *, file_tells: bool) -> Constant:
        """Return the change of the camera as a constant that starts where it is."""
        return CameraChange(file_deviations(self.config) if file_tells else None, self.imaging.change)

    @property
    def _reference(self) -> str:
        """Name of the view of the reference camera; of another one if it does not show the instrument in any frame."""
        shown = [stored for stored in self.stored if stored.in_reference] or self.stored
        return str(shown[0].views[0].name)

    def _fitted(self) -> Iterator[tuple[FrameFit, StoredFrame]]:
        """Return the fit and the stored evidence of each frame."""
        return zip(self.fits, self.stored, strict=True)
