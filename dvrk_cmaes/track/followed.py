"""What a tracker follows, by what, and how it looks: what its parts have in common."""

from __future__ import annotations

from dataclasses import dataclass

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.view_segmenter import ViewSegmenter


@dataclass(frozen=True, eq=False)
class Followed:
    """The views, the instrument, the kinematics of its arm, all settings, and what finds masks in the images."""

    rig: Rig
    body: Body
    arm: Arm
    config: EstimateConfig
    segmenter: ViewSegmenter

    @property
    def instrument(self) -> Instrument:
        """The instrument that is followed."""
        return self.body.instrument
