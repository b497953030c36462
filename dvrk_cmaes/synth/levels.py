"""How hard a made session is: four levels, each a set of figures that others can cite.

The readings' errors follow what was seen on real arms: wrist joints several degrees off, mostly by one bias a session,
the jaw half as much again, the arm's yaw and pitch good to 0.1 deg and its insertion to 0.4 mm. The masks' mistakes are
those of segmenting networks: coarse logits, a wavering outline, lumps and bites, highlights lost.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

LevelName = Literal["clean", "easy", "medium", "hard"]


@dataclass(frozen=True)
class Mistakes:
    """How badly a mask is segmented; lengths in pixels.

    Parameters
    ----------
    cell
        Side of a logit's cell.
    wave, wavelength
        Rms wavering of the outline, and over what length it wavers.
    lumps
        How many lumps and bites the outline has, about as many of each.
    holes
        How many highlights are missing from the inside.
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
    """A level's figures: root mean square over many sessions, unless said otherwise.

    Parameters
    ----------
    name
        What it is called.
    least_tilt_deg, arm_tilt_deg, least_bend_deg, least_jaw_px
        Which pictures count as sensible, see ``synth.poses.View``.
    wrist_deg, jaw_ratio
        Error of the wrist's readings; the jaw's is so many times as large. Four fifths of it are a session's bias.
    roll_deg
        Bias of the roll's reading in a session.
    arm_deg, insertion_mm
        Noise of the yaw's and pitch's readings (and of the roll's, besides its bias), and of the insertion's.
    mistakes
        The segmenter's, None for a mask exact to the pixel.
    occluded, told
        Share of the frames in which tissue lies before a jaw, and of those the share whose ``ignore`` says so.
    lens_edge
        Radius of the round picture in shares of half the image's diagonal; beyond it the image is black, and
        ignored. None for a picture that fills the image.
    distortion
        Of the default camera's lens (plumb_bob).
    tip_px, marker_px, marker_share
        Noise of the tips' and of the markers' pixels, each way, and the share of the markers that are detected.
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
    told: float = 0.0
    lens_edge: float | None = None
    distortion: tuple[float, ...] = ()
    jaw_ratio: float = 1.5
    arm_deg: float = 0.1
    insertion_mm: float = 0.4
    tip_px: float = 1.5
    marker_px: float = 1.0
    marker_share: float = 0.65

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


_BARREL: Final = (-0.24, 0.10, 0.0004, -0.0006, 0.0)

LEVELS: Final[dict[LevelName, Level]] = {
    "clean": Level(
        name="clean",
        least_tilt_deg=25.0,
        arm_tilt_deg=(45.0, 68.0),
        least_bend_deg=16.0,
        least_jaw_px=200,
        wrist_deg=5.0,
        roll_deg=5.0,
    ),
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
    "medium": Level(
        name="medium",
        least_tilt_deg=25.0,
        arm_tilt_deg=(45.0, 68.0),
        least_bend_deg=16.0,
        least_jaw_px=200,
        wrist_deg=5.0,
        roll_deg=5.0,
        mistakes=Mistakes(cell=2, wave=0.9, wavelength=24.0, lumps=3, holes=2, lump_radius=(2.0, 5.0)),
        occluded=0.2,
        told=1.0,
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
        told=0.5,
        lens_edge=0.88,
        distortion=_BARREL,
        marker_px=4.0,
    ),
}
"""The levels, from the easiest mask to the hardest."""
