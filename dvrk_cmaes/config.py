"""All settings of an estimate, one tree of frozen dataclasses; the resolved tree is written into every result."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class ReadingSpread:
    """Standard deviations of joint readings, in degrees: how far a cable-driven joint may be off."""

    wrist_pitch_deg: float = 10.0
    wrist_yaw_deg: float = 10.0
    jaw_deg: float = 15.0
    other_deg: float = 10.0

    def of(self, joint: str) -> float:
        """Return the standard deviation of one joint's reading, in degrees."""
        return float(getattr(self, f"{joint}_deg", self.other_deg))


@dataclass(frozen=True)
class SearchConfig:
    """The global search.

    ``samples`` LookAt candidates are scored on images ``width_px`` wide, of meshes without details below ``detail_m``;
    the ``starts`` best that differ are each searched by ``method`` with ``evaluations`` of the loss; ``spares`` more go
    on to the refinement as they are. Of the candidates, ``free_share`` ignore the shaft's edges and ``unread_share``
    the readings; ``unread_spares`` of these go on whatever the readings say: should the readings be wrong, the outline
    must be able to tell.
    """

    method: str = "cmaes"
    samples: int = 768
    starts: int = 4
    evaluations: int = 64
    spares: int = 22
    width_px: int = 160
    detail_m: float = 3e-4
    use_edges: bool = True
    free_share: float = 0.15
    unread_share: float = 0.25
    unread_spares: int = 5


@dataclass(frozen=True)
class LookAtRange:
    """Limits of LookAt samples: angles in rad, distance in m.

    The shaft points away from the camera plane, so alpha and gamma stay below 90 degrees; the turn about the shaft,
    beta, is free.
    """

    tilt: float = math.radians(80)
    near: float = 0.05
    far: float = 0.22


@dataclass(frozen=True)
class LossWeights:
    """Weights l1 to l5 of the paper's losses, and that of the readings.

    Silhouette terms are per pixel of the mask. Jaw tips found on a mask are often something else: they count
    ``found_tips`` times what given ones do. ``line_offset`` (1/px) makes an edge's shift comparable with its turn
    in rad. Chosen by the ablation on made frames.
    """

    mse: float = 1.0
    dist: float = 0.5
    scale: float = 0.3
    cylinder: float = 0.3
    keypoints: float = 0.002
    found_tips: float = 0.2
    readings: float = 0.004
    line_offset: float = 0.005


@dataclass(frozen=True)
class OutlineConfig:
    """How the outline is fitted.

    ``blur`` px of the level's image; ``cauchy`` is the coverage difference beyond which a residual counts less,
    ``small_cauchy`` that on smaller images, ``last_cauchy`` that of the last steps at full size, when all but a
    segmenter's mistakes is small; ``correlation`` px of outline make one measurement until the frame's own length is
    known; ``noise_floor`` px, the least error an outline is given; ``keypoint_sigma`` px of given tips; ``tolerance``
    in standard deviations, below which a step is the last. ``steps`` are those of the differences: along the root's
    axes, m, about them, rad, and of the joints, rad.
    """

    iterations: int = 40
    blur: float = 1.2
    lines_per_pixel: int = 2
    cauchy: float = 0.5
    small_cauchy: float = 0.25
    last_cauchy: float = 0.03
    correlation: float = 8.0
    noise_floor: float = 0.15
    keypoint_sigma: float = 2.0
    translation_step: float = 1e-4
    swing_step: float = 2e-3
    turn_step: float = 1e-2
    joint_step: float = 1e-2
    tolerance: float = 0.05


@dataclass(frozen=True)
class RefineConfig:
    """The local refinement: ``method`` and, for all but Gauss-Newton, its ``evaluations`` of the loss.

    All candidates are refined by ``first_steps`` steps on the search's small images, ``small_modes`` modes by
    ``small_steps`` more there, ``half_size_modes`` at half the image size and ``modes`` at full size.
    """

    method: str = "gauss-newton"
    evaluations: int = 400
    first_steps: int = 3
    small_modes: int = 10
    small_steps: int = 12
    half_size_modes: int = 3
    modes: int = 2
    outline: OutlineConfig = field(default_factory=OutlineConfig)


@dataclass(frozen=True)
class TrustConfig:
    """Thresholds beyond which a result is doubtful, set on made frames of all levels and on falsified ones.

    ``least_iou``: overlap of silhouette and mask. ``largest_contour_px``: what 95 % of the mask's contour must be
    within. ``largest_bend_px`` and ``largest_bend_share`` of the shaft's width, of which the larger holds: how far the
    silhouette may bend along a straight line that ends the mask. ``least_score_gap``: log-likelihood by which
    another mode must be worse; ``largest_outline_gap``: by which the outline alone may prefer one.
    ``largest_reading_sigmas``: deviation of one joint from its reading; ``largest_reading_sum``: squared deviations of
    all. ``unobservable_share``: of a reading's spread, for a joint's standard deviation.
    """

    least_iou: float = 0.85
    largest_contour_px: float = 3.5
    largest_bend_px: float = 3.0
    largest_bend_share: float = 0.06
    least_score_gap: float = 3.0
    largest_outline_gap: float = 2.0
    largest_reading_sigmas: float = 2.8
    largest_reading_sum: float = 7.8
    unobservable_share: float = 0.9


@dataclass(frozen=True)
class SessionConfig:
    """How the frames of a session are solved together.

    Standard deviations of a reading from frame to frame, once the session's offset is taken out: ``arm_deg`` of the
    outer yaw and pitch, ``insertion_mm``, ``roll_deg``, ``wrist_deg``, ``jaw_deg``. They are a start, as strong as
    ``spread_frames`` frames against what the session shows; the arm's may grow up to ``arm_growth`` times, the
    cable-driven joints' up to ``cable_growth`` times. A joint that is farther off than ``tail`` times its spread is
    taken for a slip of that frame. ``slack_mm`` and ``slack_deg`` are the root's own, for what joints do not explain.
    Offsets are expected within ``insertion_offset_mm``, ``roll_offset_deg``, and those of the instrument's joints
    within their readings' spread. Frames and session are solved in turn for ``rounds``; in the first, frames may be
    ``loosened`` times as far off, and turned about the shaft by ``turn_deg`` either way to start with; ``cauchy`` is
    the outline's robust loss. A frame whose squared misfit per degree of freedom is above ``largest_misfit`` is left
    out; one that a session's prediction explains as well is not searched anew.
    """

    arm_deg: float = 0.1
    insertion_mm: float = 0.4
    roll_deg: float = 3.0
    wrist_deg: float = 3.5
    jaw_deg: float = 5.0
    spread_frames: float = 1.0
    arm_growth: float = 5.0
    cable_growth: float = 1.5
    tail: float = 2.0
    slack_mm: float = 0.2
    slack_deg: float = 0.1
    insertion_offset_mm: float = 0.5
    roll_offset_deg: float = 20.0
    rounds: int = 4
    loosened: float = 4.0
    turn_deg: float = 30.0
    cauchy: float = 0.25
    largest_misfit: float = 12.0


@dataclass(frozen=True)
class EstimateConfig:
    """Settings of `estimate`; ``field`` is the distance field's method, ``decay`` (px) its length.

    More than one of ``threads`` only pays where images are large: on a frame's many small ones they wait for each other
    at the interpreter's lock. A folder's frames go to processes instead.
    """

    search: SearchConfig = field(default_factory=SearchConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    weights: LossWeights = field(default_factory=LossWeights)
    readings: ReadingSpread = field(default_factory=ReadingSpread)
    lookat: LookAtRange = field(default_factory=LookAtRange)
    trust: TrustConfig = field(default_factory=TrustConfig)
    session: SessionConfig = field(default_factory=SessionConfig)
    distance_field: str = "fmm"
    decay_px: float = 30.0
    threads: int = 1
    seed: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Return the whole tree as plain dictionaries."""
        return dataclasses.asdict(self)
