"""Blocks: named groups of unknowns that the frames of a session share, and a calibration as the values of them.

A block has a prior, a retraction (how a step changes its value), and a derivative: a `PredictedBlock` of the poses and
joints that are predicted of the frames, a `SeenBlock` of the points of their outlines in the images. A `TestedBlock` of
either kind is what a file states: every session says what its frames show of it.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from scipy.linalg import block_diag
from scipy.special import softmax

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Float64, Posed, adjoint, inverse, moved
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number, Texts
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.silhouette import OutlinePoints

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.endoscope import EndoscopeValues
    from dvrk_cmaes.calibration.model import SessionModel

BASE, OFFSETS, ENDOSCOPE = "base", "offsets", "endoscope"
"""Names of the blocks that predict a frame's pose and joints."""
BASE_AXES = ("tx", "ty", "tz", "rx", "ry", "rz")
"""Components of a small change of camera_from_base, along and about the base's axes, m and rad."""
OUTER_OFFSETS = ("insertion", "roll")
"""Outer joints that have an offset; constant offsets of yaw and pitch are equivalent to a rotation of the base."""
OBSERVABLE: Final = 0.9
"""Ratio of the posterior to the prior standard deviation, below which a session determines an unknown."""
CLEAR: Final = 3.0
"""Standard deviations from the value of a file, beyond which an unknown differs from it."""
NAMED: Final = 2.5
"""Standard deviations from the value of a file, above which one of several unknowns is named."""
_WEAK: Final = 50.0  # times a prior's standard deviations, where it hardly counts
_CARELESS, _SHARES = 3.0, np.array([0.3, 0.05])
"""Factor on the errors of a file that was made with less care; shares of such files, and of those of another thing."""


class Block:
    """A named group of n unknowns, whose prior is normal about zero deviation.

    Parameters
    ----------
    name
        Name of the block.
    std : (n,)
        Standard deviations of the prior; infinite where nothing is known.

    ``information`` (n, n) is the information matrix of the prior.
    """

    shared: bool = False
    """Whether the arms of a session have it in common: it stands in their problem once."""

    def __init__(self, name: str, std: Float64) -> None:
        self.name, self.std, self.information = name, std, np.diag(std**-2.0)

    def deviation(self, value: Any) -> Float64:
        """Return the differences (n,) of a value from the mean of the prior; of most blocks, the value itself."""
        return np.asarray(value, dtype=np.float64)

    def changed(self, value: Any, step: Float64) -> Any:
        """Return a value after a step (n,); of most blocks, the sum."""
        return value + step


class PredictedBlock(Block, ABC):
    """A block that changes what is predicted of the frames."""

    def change(self, model: SessionModel, calibration: Calibration) -> Float64 | None:
        """Return the changes (N, 6 + J) of the predictions by the block; None where the model knows them."""
        return None

    @abstractmethod
    def derivative(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes (N, 6 + J, n) of the predictions by a step, in the roots' axes, m and rad."""

    def carried(self, derivative: Float64, calibration: Calibration) -> Float64:
        """Return the derivative (N, 6 + J, K) by blocks before this one after its change; by default the same."""
        return derivative


class Base(PredictedBlock):
    """The arm's base (4, 4) in the camera, with a prior of a metre and a radian; steps are in the base's axes."""

    def __init__(self) -> None:
        super().__init__(BASE, np.ones(6))

    def deviation(self, value: Any) -> Float64:
        """Return zero: no base is expected, so that its prior does not move an estimate."""
        return np.zeros(6)

    def changed(self, value: Any, step: Float64) -> Float64:
        """Return the base after a step along and about its own axes."""
        return moved(value, step)

    def derivative(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes of the roots' poses by that of the base."""
        out = np.zeros((len(model.outer), 6 + len(model.names), 6))
        out[:, :6] = adjoint(inverse(model.base_from_root(calibration.offsets)))
        return out


class Offsets(PredictedBlock):
    """The offsets (2 + J,) of insertion, roll and the instrument's joints, m and rad: true = reading + offset."""

    def __init__(self, std: Float64) -> None:
        super().__init__(OFFSETS, std)

    def derivative(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes: insertion moves the root along its z axis, roll turns it about this axis."""
        count = len(model.names)
        one = np.zeros((6 + count, 2 + count))
        one[2, 0] = one[5, 1] = 1.0
        one[6:, 2:] = np.eye(count)
        return np.broadcast_to(one, (len(model.outer), *one.shape))


@dataclass(frozen=True, eq=False)
class ViewAsSeen:
    """How a view is taken to see the instrument: its ``camera``, and its mask's ``margin``, px."""

    camera: Camera
    margin: float = 0.0


@dataclass(frozen=True, eq=False)
class OutlineOfView:
    """The N points of the outline of a pose ``at`` in a view."""

    view: SizedView
    points: OutlinePoints
    at: Posed


class TestedBlock(Block, ABC):
    """A block of what a file states, by which every session tests it: camera, masks, or instrument.

    Parameters
    ----------
    name, std
        As of `Block`.
    start : (n,)
        Values from which estimates start; zero by default.

    ``known`` (n,) are the standard deviations of what is known a priori, those of the prior by default, and ``weak``
    (n,) those with which it is asked what the frames show by themselves. ``least_std`` (n,) are standard deviations of
    errors that the scatter of a session's frames does not show; by default none. ``used`` is whether the session is
    solved with the values that are found.
    """

    parameters: ClassVar[tuple[str, ...]] = ()
    """Which of the `PARAMETERS` of camera and instrument the unknowns are; by default none."""
    is_alike: ClassVar[bool] = True
    """Whether errors that all masks share widen what the frames show of it (``session.shared_errors``)."""
    widens: ClassVar[bool] = True
    """Whether the errors that are left of it widen the calibration."""

    def __init__(self, name: str, std: Float64, start: Float64 | None = None) -> None:
        super().__init__(name, std)
        self.start, self.least_std = np.zeros(len(std)) if start is None else start, np.zeros(len(std))
        self.known, self.weak, self.used = std, _WEAK * std, False

    def is_plausible(self, values: Float64) -> bool:
        """Whether outlines that are linearised at some values (n,) are still near the masks; by default always."""
        return True

    @abstractmethod
    def stated(self, alone: Float64, covariance: Float64) -> tuple[FoundBlock, Float64]:
        """State what is found of the unknowns, and return the mean square (n, n) of the errors that are left of them.

        Values that are not used are left as errors. ``alone`` (n,) and ``covariance`` (n, n) are what the frames show
        by themselves, without the prior.
        """


class SeenBlock(TestedBlock):
    """A block that changes what the views show."""

    @property
    def is_linear(self) -> bool:
        """Whether the outlines are always linearised where the unknowns are zero, as no value changes how views see."""
        return type(self).seen is SeenBlock.seen

    def seen(self, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return how a view sees with the values (n,); by default as it does with any, as the effect is linear.

        Raises
        ------
        InputError
            With the values, the lens distortion is not one-to-one over the image.
        """
        return by

    @abstractmethod
    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements (N, n) of the outline's points by the unknowns, times their normals' lengths, px."""


@dataclass(frozen=True)
class FoundBlock(Document):
    """What a session finds of a block: by unknown, ``values`` with posterior and prior standard deviations.

    ``text`` says so in words, ``doubt`` by how much it contradicts a file, empty where it does not. ``applied`` is
    whether the session was solved with the values, else with zero. ``moves``, a row for each unknown of the calibration
    in the order of its covariance, is by how much this is off per unit of each of the block's.
    """

    axes: Texts
    values: tuple[Number, ...]
    std: tuple[Number, ...]
    prior_std: tuple[Number, ...]
    text: str
    doubt: str = ""
    applied: bool = False
    moves: tuple[tuple[Number, ...], ...] = field(default=(), repr=False)

    @classmethod
    def of(
        cls,
        axes: Sequence[str],
        each: tuple[Float64, Float64, Float64],
        text: str,
        doubt: str = "",
        *,
        applied: bool = False,
    ) -> FoundBlock:
        """State ``each`` of values, posterior and prior standard deviations (n,); other arguments are the fields."""
        values, std, prior_std = (tuple(one.tolist()) for one in each)
        return cls(tuple(axes), values, std, prior_std, text, doubt, applied)

    def moving(self, moves: Float64) -> FoundBlock:
        """Return the same with other moves (K, n)."""
        return replace(self, moves=tuple(map(tuple, moves.tolist())))

    def after(self, change: Float64) -> FoundBlock:
        """Return the same for a calibration that is a linear function (K', K) of this session's."""
        return self.moving(change @ self.moves) if self.moves else self


@dataclass(frozen=True, eq=False)
class BlockCheck:
    """What a session's frames show of its blocks, and what errors that are left of these do to the calibration.

    ``blocks`` are what is found, without the camera where it is not tested. ``covariance`` (K, K) is the mean square of
    the calibration's errors that errors of the blocks cause. ``errors`` (6, 6) is that of camera and instrument with
    which the session was solved, in the order of `PARAMETERS`: what it finds and does not use is an error as well.
    """

    covariance: Float64
    errors: Float64
    blocks: Mapping[str, FoundBlock]


@dataclass(frozen=True, eq=False)
class Calibration:
    """The values of the K unknowns of a session's blocks, in the order of a step: those that are tested are the last.

    ``values`` are those of the ``blocks`` by name.
    """

    blocks: tuple[Block, ...]
    values: Mapping[str, Any]

    @property
    def camera_from_base(self) -> Float64:
        """The base (4, 4) in the reference camera, m."""
        return np.asarray(self.values[BASE])

    @property
    def offsets(self) -> Float64:
        """The offsets (2 + J,), m and rad."""
        return np.asarray(self.values[OFFSETS])

    @property
    def endoscope(self) -> EndoscopeValues | None:
        """The values of an endoscope that moves; None of one that stands still."""
        found: EndoscopeValues | None = self.values.get(ENDOSCOPE)
        return found

    @property
    def deviation(self) -> Float64:
        """Differences (K,) from the mean of the prior."""
        return np.concatenate([block.deviation(self.values[block.name]) for block in self.blocks])

    @property
    def information(self) -> Float64:
        """Information matrix (K, K) of the prior."""
        return np.asarray(block_diag(*(block.information for block in self.blocks)))

    @property
    def predicted(self) -> tuple[PredictedBlock, ...]:
        """The blocks that change what is predicted."""
        return tuple(block for block in self.blocks if isinstance(block, PredictedBlock))

    @property
    def seen(self) -> tuple[SeenBlock, ...]:
        """The blocks that change what the views show."""
        return tuple(block for block in self.blocks if isinstance(block, SeenBlock))

    @property
    def tested(self) -> tuple[TestedBlock, ...]:
        """The blocks that are tested."""
        return tuple(block for block in self.blocks if isinstance(block, TestedBlock))

    @property
    def own(self) -> int:
        """Number of unknowns that are not tested."""
        return sum(len(block.std) for block in self.alone().blocks)

    @property
    def further(self) -> Float64:
        """Values (E,) of the unknowns that change what the views show, block after block."""
        return np.concatenate([np.zeros(0), *(self.values[block.name] for block in self.seen)])

    def place(self, name: str) -> slice:
        """Return where a block is among the components of a step."""
        number = [block.name for block in self.blocks].index(name)
        ends = np.cumsum([0, *(len(block.std) for block in self.blocks)]).tolist()
        return slice(ends[number], ends[number + 1])

    def changed(self, step: Float64) -> Calibration:
        """Return the calibration after a step (K,)."""
        changed = {one.name: one.changed(self.values[one.name], step[self.place(one.name)]) for one in self.blocks}
        return Calibration(self.blocks, changed)

    def with_blocks(self, *blocks: Block, **values: Any) -> Calibration:
        """Return the calibration with further blocks and other values, those of tested blocks by default their start.

        A block takes the place of one of the same name.
        """
        new = {block.name: block for block in blocks}
        whole = [new.pop(block.name, block) for block in self.blocks] + list(new.values())
        whole.sort(key=lambda block: isinstance(block, TestedBlock))
        starts = {block.name: block.start for block in blocks if isinstance(block, TestedBlock)}
        return Calibration(tuple(whole), {**self.values, **starts, **values})

    def alone(self, without: str = "") -> Calibration:
        """Return the calibration without the blocks that are tested, and without that of some name."""
        kept = tuple(block for block in self.blocks if not isinstance(block, TestedBlock) and block.name != without)
        return Calibration(kept, {block.name: self.values[block.name] for block in kept})


def with_prior(alone: Float64, covariance: Float64, std: Float64) -> tuple[Float64, Float64]:
    """Return values (n,) and their covariance (n, n) with normal priors about zero, of standard deviations (n,)."""
    gain = np.diag(std**2) @ np.linalg.inv(covariance + np.diag(std**2))
    return gain @ alone, gain @ covariance


def distance(alone: Float64, covariance: Float64, std: Float64) -> float:
    """Return the squared Mahalanobis distance of values from zero; arguments as of `with_prior`."""
    return float(alone @ np.linalg.solve(covariance + np.diag(std**2), alone))


def with_mixture(
    alone: Float64, covariance: Float64, priors: Sequence[tuple[float, Float64]]
) -> tuple[Float64, Float64]:
    """Return the mean (n,) and mean square (n, n) of values whose prior is a mixture of normal ones about zero.

    ``priors`` are the share of each and its standard deviations (n,).
    """
    each = [with_prior(alone, covariance, std) for _, std in priors]
    whole = [np.linalg.slogdet(covariance + np.diag(std**2))[1] + distance(alone, covariance, std) for _, std in priors]
    weights = softmax(np.log([share for share, _ in priors]) - 0.5 * np.array(whole))
    squares = [spread + np.outer(mean, mean) for mean, spread in each]
    return np.einsum("k,ki->i", weights, [mean for mean, _ in each]), np.einsum("k,kij->ij", weights, squares)


def square_by_file(
    alone: Float64, covariance: Float64, std: Float64, groups: Sequence[int], other: float = 10.0
) -> Float64:
    """Return the mean square (n, n) of the errors of values that are used as a file has them, by what frames show, too.

    Errors of files have heavy tails. Their standard deviations are ``std`` (n,); with some probability three times
    these, or ``other`` times, where the file is that of another camera or tool. Values of one of the ``groups`` (n,),
    numbered from 0, err alike. The less frames could show of such an error, the less probable is it taken to be.
    """
    numbers, factors = np.array(groups), np.array([1.0, _CARELESS, other])
    known = (1 + np.diag(covariance) / (factors[1:, None] * std) ** 2) ** -2
    wrong = [_SHARES * known[:, numbers == number].mean(axis=1) for number in range(max(groups) + 1)]
    shares, priors = [np.array([1 - own.sum(), *own]) for own in wrong], []
    for each in itertools.product(range(len(factors)), repeat=len(shares)):
        share = float(np.prod([own[k] for own, k in zip(shares, each, strict=True)]))
        priors.append((share, std * factors[np.array(each)[numbers]]))
    return with_mixture(alone, covariance, priors)[1]
