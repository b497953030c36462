"""Estimation of what cables do to a session's readings, from the outline fits of its frames.

Given the base, each frame's fit is an uncertain observation of the errors of roll and of the instrument's joints.
Models of these errors, one offset a joint, with coupling, with wander, and with all parts, are compared by the
likelihood of all observations with the priors of `joints.cable_prior`. A larger model is only used where it is more
likely than one offset by a margin; otherwise nothing is corrected. Each frame is corrected by what all other frames
show of it.

Frames are fitted with the corrections of the round before as a prior, and favour the model that these have. So the
margin only holds in the last round; before, frames are fitted with the most likely model.

The parameters are not unknowns of the session's linearised problem, as its other constants are: the choice between the
models needs the likelihood of each, which the filters give with the parameters, and wander differs from frame to frame.
As such unknowns, those of a chosen model find the same base, and predict frames that are left out hardly better.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from dvrk_cmaes.calibration.lag import SessionLag
from dvrk_cmaes.calibration.model import ROLL, Correction, frames_alike
from dvrk_cmaes.calibration.solve import ArmFrames, Solved
from dvrk_cmaes.geometry import Bool, Float64, Indices
from dvrk_cmaes.io.encode import Document, rounded, rounded_array
from dvrk_cmaes.io.typed_document import Number, Texts, refused
from dvrk_cmaes.joints.cable_inference import Assumed, Inference, Observations, log_likelihood
from dvrk_cmaes.joints.cable_prior import NARROW, CablePrior, Play, cable_prior, features

Part = Literal["coupling", "play", "wander"]
Row = tuple[Number, ...]
Table = tuple[Row, ...]

_MODELS: Final[tuple[tuple[Part, ...], ...]] = ((), ("coupling",), ("wander",), ("coupling", "play", "wander"))
_NOISES: Final = (2.0, 1.2, 0.7, 0.4, 0.2, 0.1)  # trial factors on the standard deviations from frame to frame
_WIDENINGS: Final = (1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 10.0)  # trial factors on the variances of predictions
MARGIN: Final = 4.0
"""Nats by which a larger model must be more likely than one offset a joint, for frames fitted with the larger one."""
_ROLL_AXIS: Final = 5  # of a small change of the root's pose
_ALIKE_SECONDS: Final = 1.0  # over which masks err alike, so that their frames count as one


@dataclass(frozen=True, eq=False)
class CableSession:
    """What a session's N frames show of the errors of C joints, roll and those of the instrument.

    ``names`` are the joints, ``readings`` (N, C) what was read, rad, NaN where nothing was. Where the frames have no
    order, ``times`` (N,), s, are NaN, and ``play`` is None. ``information`` (N, C, C) and ``vector`` (N, C) are the
    observations of the errors beyond ``offsets`` (C,), whose prior has the standard deviations ``offset_std`` (C,).
    ``noise`` (C,) are the usual standard deviations from frame to frame, rad.
    """

    names: tuple[str, ...]
    readings: Float64
    times: Float64
    play: Play | None
    information: Float64
    vector: Float64
    offsets: Float64
    offset_std: Float64
    noise: Float64

    @property
    def order(self) -> Indices:
        """Indices of the frames in the order of time."""
        return np.argsort(self.times, kind="stable")


@dataclass(frozen=True, eq=False)
class CableFit:
    """A model of the errors of a session's cables, fitted to its frames.

    ``names`` are the joints. ``parts`` are those besides the offsets; ``gain`` is the logarithm of the ratio of its
    likelihood to that of offsets alone. ``reference`` (C,) are the readings at which coupling adds nothing.
    ``coupling`` and ``play`` (C, C), with what the joint's own narrow band adds, have standard deviations; they are
    zero where a part is missing. ``wander`` and ``noise`` (C,), rad, are standard deviations. ``offset`` (C,), rad, are
    the mean errors at the reference. ``correction`` is that of each frame by the others.
    """

    names: tuple[str, ...]
    parts: tuple[Part, ...]
    gain: float
    reference: Float64
    coupling: Float64
    coupling_std: Float64
    play: Float64
    play_std: Float64
    wander: Float64
    noise: Float64
    offset: Float64
    correction: Correction

    def deviations(self, usual: Float64) -> Float64:
        """Return the standard deviations of corrected readings from frame to frame; the usual ones without parts."""
        return np.concatenate([usual[:ROLL], self.noise, usual[-6:]]) if self.parts else usual


def estimate_cables(solution: Solved, lag: SessionLag, usual: Float64, *, last: bool) -> tuple[CableFit, CableFit]:
    """Fit the cables of a session; returns the fits of `fit_cables`.

    Parameters
    ----------
    solution
        The frames of an arm that is solved.
    lag
        Has the frames' times, and the readings between them.
    usual : (10 + J,)
        Standard deviations of readings from frame to frame without corrections.
    last
        Whether it is the last round.
    """
    model, times = solution.model, lag.seconds()
    names = ("roll", *model.names)
    information, vector = observe_errors(solution, solution.weights / frames_alike(times, _ALIKE_SECONDS))
    readings, prior = np.concatenate([model.outer[:, ROLL:], model.joints], axis=1), cable_prior(names)
    play, offsets = lag.play(names, readings, prior.model.width), solution.calibration.offsets[1:]
    noise, std = usual[ROLL:-6], model.offset_std[1:]
    seen = CableSession(names, readings, times, play, information, vector, offsets, std, noise)
    return fit_cables(seen, prior, MARGIN if last else 0.0)


def observe_errors(solution: ArmFrames, weights: Float64) -> tuple[Float64, Float64]:
    """Return information (N, C, C) and vector (N, C) of each frame about the errors beyond the offsets.

    Pose and slack of the frames are eliminated; ``weights`` (N,) are robust ones. The model's corrections do not count.
    """
    model, fits, calibration = solution.model, solution.fits, solution.calibration
    count = len(model.names)
    bare = replace(model, correction=Correction.none(len(model.outer), count))
    off = bare.predict(calibration).minus(fits.at)
    others = np.delete(bare.by_errors(calibration) * model.deviations, slice(ROLL, -6), axis=2)
    spread = others @ np.swapaxes(others, 1, 2)
    loading = np.zeros((6 + count, 1 + count))
    loading[_ROLL_AXIS, 0] = 1.0
    loading[6:, 1:] = np.eye(count)
    known, slope = fits.outlines.normal_equations(off)
    widened = np.eye(6 + count) + known @ spread
    seen = np.linalg.solve(widened, np.concatenate([known @ loading, slope[..., None]], axis=2))
    seen = weights[:, None, None] * (loading.T @ seen)
    read = ~np.isnan(np.concatenate([model.outer[:, 3:], model.joints], axis=1))
    information = seen[:, :, :-1] * read[:, :, None] * read[:, None]
    return (information + np.swapaxes(information, 1, 2)) / 2, -seen[:, :, -1] * read


def fit_cables(session: CableSession, prior: CablePrior, margin: float = MARGIN) -> tuple[CableFit, CableFit]:
    """Fit all models, and return the most likely one; one offset a joint unless another is by ``margin`` nats more so.

    The second one is the most likely of those that need nothing but the reading of a frame itself.
    """
    fits = [_fit(session, prior, parts) for parts in _MODELS if session.play is not None or "wander" not in parts]
    least = fits[0].gain

    def most_likely(among: list[CableFit]) -> CableFit:
        best = max(among, key=lambda fit: fit.gain)
        best = best if best.gain > least + margin else among[0]
        return replace(best, gain=best.gain - least)

    return most_likely(fits), most_likely([fit for fit in fits if "wander" not in fit.parts])


def _widening(given: Observations, means: Float64, covariances: Float64) -> Float64:
    """Return the factors (C,) on the variances of the frames' predictions by the others that fit the frames best.

    ``means`` (N, C) and ``covariances`` (N, C, C) are of the predictions, with noise.
    """
    factors = np.ones(means.shape[1])

    def likelihood(joint: int, factor: float) -> float:
        tried = np.sqrt(np.where(np.arange(len(factors)) == joint, factor, factors))
        widened = covariances * tried[:, None] * tried
        return float(log_likelihood(given.information, given.vector, means, widened).sum())

    for joint in range(len(factors)):
        factors[joint] = max(_WIDENINGS, key=lambda factor: likelihood(joint, factor))
    return factors


def _reference(session: CableSession) -> Float64:
    """Return the mean readings (C,), zero for a joint that was never read."""
    read = ~np.isnan(session.readings)
    return np.asarray(np.where(read, session.readings, 0.0).sum(axis=0) / np.maximum(read.sum(axis=0), 1))


def _fit(session: CableSession, prior: CablePrior, parts: tuple[Part, ...]) -> CableFit:
    """Fit one model with each of the trial noises; the most likely one, whose ``gain`` is its likelihood.

    That is the logarithm of the likelihood of all observations.
    """
    count = len(session.names)
    active = np.zeros((count, 2 * count + 1), np.bool_)
    active[:, :count] = "coupling" in parts
    active[:, count:] = "play" in parts
    given = _observations(session, active)
    mean = np.concatenate([-session.offsets, prior.model.coefficients[active]])
    std = np.concatenate([session.offset_std, prior.spread[active]])
    usual, seconds = 1.0 if "wander" in parts else 0.0, prior.model.seconds
    trials = [Assumed(mean, std, usual * prior.model.wander, seconds, noise * session.noise) for noise in _NOISES]
    assumed, found = max(((one, Inference(given, one)) for one in trials), key=lambda own: own[1].log_likelihood)
    coefficients, deviations = np.zeros(active.shape), np.zeros(active.shape)
    coefficients[active], deviations[active] = found.mean[count:], np.sqrt(np.diag(found.covariance)[count:])
    correction, noise = Correction.none(len(session.readings), count - 1), assumed.noise
    if parts:
        means, covariances = found.left_out
        widening = _widening(given, means, covariances + np.diag(noise**2))
        back = np.argsort(session.order)
        values = (means - found.mean[:count])[back]
        correction = Correction(values, widening * np.einsum("nii->ni", covariances)[back])
        noise = noise * np.sqrt(widening)
    coupling, play, narrow = np.split(coefficients, [count, 2 * count], axis=1)
    coupling_std, play_std, narrow_std = np.split(deviations, [count, 2 * count], axis=1)
    own = NARROW * np.eye(count)
    return CableFit(
        names=session.names,
        parts=parts,
        gain=found.log_likelihood,
        reference=_reference(session),
        coupling=coupling,
        coupling_std=coupling_std,
        play=play + own * narrow,
        play_std=np.hypot(play_std, own * narrow_std),
        wander=assumed.wander,
        noise=noise,
        offset=session.offsets + found.mean[:count],
        correction=correction,
    )


def _observations(session: CableSession, active: Bool) -> Observations:
    """Return the frames' observations in the order of time, with offsets and the active coefficients as unknowns."""
    frames, count = session.readings.shape
    play = session.play or Play(np.zeros((frames, count)), np.zeros((frames, count)))
    every = features(session.readings, play, _reference(session))
    own = np.argwhere(active)
    terms = np.zeros((frames, count, count + len(own)))
    terms[:, np.arange(count), np.arange(count)] = 1.0
    for k, (joint, feature) in enumerate(own):
        terms[:, joint, count + k] = every[:, joint, feature]
    times, order = np.where(np.isnan(session.times), np.arange(frames), session.times), session.order
    return Observations(times[order], terms[order], session.information[order], session.vector[order])


_CERTAIN = 2.0  # standard deviations beyond which a coefficient is described in words,
_LEAST_COUPLING = 0.03  # if it is at least this, rad a rad,
_LEAST_PLAY = np.deg2rad(1.0)  # or moves a joint by at least this,
_DETERMINED = 0.8  # and if its standard deviation is at most this share of the prior's


@dataclass(frozen=True)
class CablesAlone:
    """What the reading of a frame alone shows of its errors, by joint: true = reading + offset + coupling.

    ``offset`` and ``noise``, rad, are mean and standard deviation of the error where the readings are the reference,
    ``coupling`` the change of the row's joint for each rad of the column's, with its standard deviation.
    """

    offset: Row
    coupling: Table
    std: Table
    noise: Row


@dataclass(frozen=True)
class SessionCables(Document):
    """The cables of a session, by joint in the order of ``joints``; rad and s.

    parts : what is used besides the offsets: coupling, play, wander. gain : logarithm of how many times more likely the
    session is with them. reference : readings at which coupling adds nothing.
    coupling, play, wander, noise : as in `joints.cables.CableModel`, play with what the joint's own narrow band adds;
    those of parts that are not used are zero. coupling_std, play_std : their standard deviations.
    alone : for frames without an order.
    """

    parts: Texts
    gain: Number
    joints: Texts
    reference: Row
    coupling: Table
    coupling_std: Table
    play: Table
    play_std: Table
    wander: Row
    noise: Row
    alone: CablesAlone

    @classmethod
    def of(cls, fits: tuple[CableFit, CableFit] | None) -> SessionCables | None:
        """Return what was estimated; None if offsets explain the frames as well.

        Parameters
        ----------
        fits
            The fit that is used, and that of what the reading of a frame alone shows; None if there is none.
        """
        if fits is None or not fits[0].parts:
            return None
        fit, alone = fits
        names = "reference", "coupling", "coupling_std", "play", "play_std", "wander", "noise"
        same: dict[str, Any] = {name: _rounded(getattr(fit, name)) for name in names}
        errors = (_rounded(one) for one in (alone.offset, alone.coupling, alone.coupling_std, alone.noise))
        return cls(fit.parts, rounded(fit.gain), fit.names, **same, alone=CablesAlone(*errors))

    def check(self, where: str, joints: Sequence[str]) -> None:
        """Raise an InputError, whose message begins with ``where``, for other joints or other numbers of numbers."""
        if self.joints != tuple(joints):
            raise refused(where, "cables.joints", ", ".join(joints), list(self.joints))
        count = len(joints)
        for owner in (self, self.alone):
            for name, value in vars(owner).items():
                numbers = isinstance(value, tuple) and name not in ("parts", "joints")
                if numbers and {len(value), *(len(row) for row in value if isinstance(row, tuple))} != {count}:
                    raise refused(where, f"cables.{name}", f"{count} numbers, or rows of {count} numbers", value)

    def correction_alone(self, readings: Float64) -> Correction:
        """Return the corrections of frames of which nothing is known but their readings (N, C), rad.

        Parameters
        ----------
        readings
            Readings (N, C) of the joints with cables, rad.
        """
        off = np.nan_to_num(readings - np.array(self.reference))
        return Correction(off @ np.array(self.alone.coupling).T, np.square(off) @ np.square(self.alone.std).T)

    def in_words(self) -> Iterator[str]:
        """Yield a line for each coefficient that is determined, the largest first.

        One about which the session says no more than its prior, as of readings that never change, is not.
        """
        count, texts = len(self.joints), list[tuple[float, str]]()
        prior = cable_prior(self.joints)
        spread, width, play, play_std = prior.spread, prior.model.width, np.array(self.play), np.array(self.play_std)
        usual = np.hypot(spread[:, count:-1], NARROW * np.diag(spread[:, -1]))
        for j, k in _clear(np.array(self.coupling), np.array(self.coupling_std), spread[:, :count], _LEAST_COUPLING):
            acts = f"{self.joints[k]} drags {self.joints[j]}" if j != k else f"{self.joints[j]} is scaled"
            value, std = self.coupling[j][k], self.coupling_std[j][k]
            texts.append((abs(value), f"{acts} by {np.degrees(value):+z.1f} deg a rad, std {np.degrees(std):.1f}"))
        for j, k in _clear(play, play_std, usual, _LEAST_PLAY / width):
            acts, size = f"play of {self.joints[k]} moves {self.joints[j]}", np.degrees(width[k])
            acts = acts if j != k else f"{self.joints[j]} stays behind its reading"
            text = f"{acts} by up to {size * abs(play[j, k]):.1f} deg, std {size * play_std[j, k]:.1f}"
            texts.append((abs(play[j, k]), text))
        yield from (text for _, text in sorted(texts, reverse=True))
        if "wander" in self.parts:
            each = ", ".join(
                f"{name} {np.degrees(std):.1f} deg over {time:.0f} s"
                for name, std, time in zip(self.joints, self.wander, prior.model.seconds, strict=True)
            )
            yield f"wander: {each}"


def _clear(values: Float64, std: Float64, usual: Float64, least: Float64 | float) -> list[list[int]]:
    """Return the places of coefficients (C, C) that are clearly not zero, at least ``least``, and better known now."""
    return np.argwhere((np.abs(values) > np.maximum(_CERTAIN * std, least)) & (std <= _DETERMINED * usual)).tolist()


def _rounded(values: Float64) -> Any:
    """Return values (C,) or (C, C) as a row or table of rounded numbers."""
    return tuple(rounded_array(values) if values.ndim == 1 else map(_rounded, values))
