"""Difficulty levels of synthetic sessions: four fixed sets of parameters.

The errors of the readings have the sizes observed on real arms: several degrees at the wrist joints, mostly a constant
bias of the session; half as much again at the jaw; 0.1 deg at the arm's yaw and pitch and 0.4 mm at its insertion. The
errors of the masks are those of segmentation networks: coarse logits, correlated noise along the outline, lumps and
bites, and missing highlights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

LevelName = Literal["clean", "easy", "medium", "hard"]


@dataclass(frozen=True)
class Mistakes:
    """Parameters of the simulated segmentation errors of a mask; lengths in pixels.

    Parameters
    ----------
    cell
        Side of a square cell of the coarse map of logits.
    wave, wavelength
        Standard deviation and wavelength of the outline's correlated noise.
    lumps
        Number of lumps and bites together, half of them lumps.
    holes
        Number of highlights that are missing inside the mask.
    lump_radius
        Smallest and largest radius of a lump or bite.
    """

    cell: int
    wave: float
    wavelength: float
    lumps: int
    holes: int
    lump_radius: tuple[float, float] = (1.8, 4.2)


@dataclass(frozen=True)
class Level:
    """Parameters of a level. Errors are root mean squares over many sessions.

    Parameters
    ----------
    name
        Name of the level.
    least_tilt_deg, arm_tilt_deg, least_bend_deg, least_jaw_px
        Limits of the accepted poses, see ``synth.poses.ViewLimits``.
    wrist_deg, jaw_ratio
        Error of the wrist's readings, and ratio of the jaw's error to it. The session's bias is 0.8 of the error; the
        remaining variance is noise of each frame.
    roll_deg
        Bias of the roll's reading in a session.
    arm_deg, insertion_mm
        Noise of the readings of yaw, pitch and roll, and of the insertion.
    mistakes
        Simulated segmentation errors, None for the exact mask.
    occluded, stated
        Share of the frames in which tissue covers the end of a jaw, and the share of those whose ``ignore`` contains
        the tissue.
    lens_edge
        Radius of the circular field of view as a fraction of half the image's diagonal; outside it the image is black
        and part of ``ignore``. None if the field of view fills the image.
    distortion
        Distortion of the default camera (plumb_bob).
    tip_px, marker_px, marker_share
        Standard deviation of the tips' and of the markers' pixels along each axis, and share of the markers that are
        detected.
    """

    name: LevelName
    least_tilt_deg: float
    arm_tilt_deg: tuple[float, float]
    least_bend_deg: float
    least_jaw_px: int
    wrist_deg: float
    roll_deg: float
    mistakes: Mistakes | None = None
    occluded: float = 0.0
    stated: float = 0.0
    lens_edge: float | None = None
    distortion: tuple[float, ...] = ()
    jaw_ratio: float = 1.5
    arm_deg: float = 0.1
    insertion_mm: float = 0.4
    tip_px: float = 1.5
    marker_px: float = 1.0
    marker_share: float = 0.65


_BARREL: Final = (-0.24, 0.10, 0.0004, -0.0006, 0.0)

_CLEAN: Final = Level(
    name="clean",
    least_tilt_deg=25.0,
    arm_tilt_deg=(45.0, 68.0),
    least_bend_deg=16.0,
    least_jaw_px=200,
    wrist_deg=5.0,
    roll_deg=5.0,
)
LEVELS: Final[dict[LevelName, Level]] = {
    "clean": _CLEAN,
    "easy": Level(
        name="easy",
        least_tilt_deg=35.0,
        arm_tilt_deg=(48.0, 66.0),
        least_bend_deg=26.0,
        least_jaw_px=300,
        wrist_deg=2.0,
        roll_deg=2.0,
        mistakes=Mistakes(cell=1, wave=0.4, wavelength=24.0, lumps=0, holes=0),
        marker_px=1.5,
    ),
    "medium": replace(
        _CLEAN,
        name="medium",
        mistakes=Mistakes(cell=2, wave=0.9, wavelength=24.0, lumps=3, holes=2, lump_radius=(2.0, 5.0)),
        occluded=0.2,
        stated=1.0,
        lens_edge=0.92,
        distortion=_BARREL,
        marker_px=2.5,
    ),
    "hard": Level(
        name="hard",
        least_tilt_deg=15.0,
        arm_tilt_deg=(35.0, 72.0),
        least_bend_deg=10.0,
        least_jaw_px=100,
        wrist_deg=8.0,
        roll_deg=8.0,
        mistakes=Mistakes(cell=4, wave=1.5, wavelength=24.0, lumps=6, holes=4, lump_radius=(3.0, 9.0)),
        occluded=0.7,
        stated=0.5,
        lens_edge=0.88,
        distortion=_BARREL,
        marker_px=4.0,
    ),
}
"""The levels by name, in order of increasing errors of the masks."""
