"""What a session tells of its cables, as in ``session.json``: coupling, play and wander beside the offsets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from dvrk_cmaes.calibration.cables import CableFit
from dvrk_cmaes.calibration.model import Correction
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.rounding import rounded, rounded_array
from dvrk_cmaes.io.typed_document import Number, Texts, refused
from dvrk_cmaes.joints.cable_prior import cable_prior
from dvrk_cmaes.joints.play import NARROW

Row = tuple[Number, ...]
Table = tuple[Row, ...]

_ROWS = {"reference", "narrow", "narrow_std", "width", "wander", "seconds", "noise", "offset"}
_TABLES = {"coupling", "coupling_std", "play", "play_std", "std"}
_CERTAIN = 2.0  # standard deviations beyond which a coefficient is described in words,
_LEAST_COUPLING = 0.03  # if it is at least this, rad a rad,
_LEAST_PLAY = np.deg2rad(1.0)  # or moves a joint by at least this,
_TOLD = 0.8  # and if its standard deviation is at most this share of the one expected beforehand


@dataclass(frozen=True)
class CablesAlone:
    """What the reading of a frame alone tells of its errors, by joint: true = reading + offset + coupling.

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

    parts : what is used beside the offsets: coupling, play, wander. gain : logarithm of how many times more likely the
    session is with them. reference : readings at which coupling adds nothing.
    coupling, play, narrow, width, wander, seconds, noise : as in `joints.cables.CableModel`; those of parts that are
    not used are zero. coupling_std, play_std, narrow_std : their standard deviations.
    alone : for frames without an order. corrections : of each frame by all others, beyond the offsets, rad.
    times : of the frames' readings, s.
    """

    parts: Texts
    gain: Number
    joints: Texts
    reference: Row
    coupling: Table
    coupling_std: Table
    play: Table
    play_std: Table
    narrow: Row
    narrow_std: Row
    width: Row
    wander: Row
    seconds: Row
    noise: Row
    alone: CablesAlone
    corrections: dict[str, Row] = field(default_factory=dict)
    times: dict[str, Number] = field(default_factory=dict)

    @classmethod
    def of(
        cls, fits: tuple[CableFit, CableFit] | None, frames: tuple[str, ...], times: Float64 | None
    ) -> SessionCables | None:
        """Return what was estimated from some frames; None if offsets explain them as well.

        Parameters
        ----------
        fits
            The fit that is used, and that of what the reading of a frame alone tells; None if there is none.
        frames
            Names of the N frames.
        times
            Times (N,) of their images, s, if they are known.
        """
        if fits is None or not fits[0].parts:
            return None
        fit, alone = fits
        count, prior = len(fit.names), cable_prior(fit.names).model
        coupling, play, narrow = np.split(fit.coefficients, [count, 2 * count], axis=1)
        coupling_std, play_std, narrow_std = np.split(fit.std, [count, 2 * count], axis=1)
        return cls(
            parts=fit.parts,
            gain=rounded(fit.gain),
            joints=fit.names,
            reference=_row(fit.reference),
            coupling=_table(coupling),
            coupling_std=_table(coupling_std),
            play=_table(play),
            play_std=_table(play_std),
            narrow=_row(narrow[:, 0]),
            narrow_std=_row(narrow_std[:, 0]),
            width=_row(prior.width),
            wander=_row(fit.wander),
            seconds=_row(prior.seconds),
            noise=_row(fit.noise),
            alone=CablesAlone(
                _row(alone.offset),
                _table(alone.coefficients[:, :count]),
                _table(alone.std[:, :count]),
                _row(alone.noise),
            ),
            corrections={name: _row(row) for name, row in zip(frames, fit.correction.values, strict=True)},
            times={} if times is None else dict(zip(frames, rounded_array(times), strict=True)),
        )

    def check(self, where: str, joints: Sequence[str]) -> None:
        """Raise an InputError, whose message begins with ``where``, for other joints or other numbers of numbers."""
        if self.joints != tuple(joints):
            raise refused(where, "cables.joints", ", ".join(joints), list(self.joints))
        count = len(joints)
        for owner in (self, self.alone):
            for name in _ROWS & vars(owner).keys():
                if len(row := getattr(owner, name)) != count:
                    raise refused(where, f"cables.{name}", f"{count} numbers, one a joint", row)
            for name in _TABLES & vars(owner).keys():
                if len(table := getattr(owner, name)) != count or any(len(row) != count for row in table):
                    raise refused(where, f"cables.{name}", f"{count} rows of {count} numbers", table)
        if min(self.seconds) <= 0:
            raise refused(where, "cables.seconds", "numbers above 0", self.seconds)

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
        """Yield a line for each coefficient that is told, the largest first.

        One about which the session says no more than is expected beforehand, as of readings that never change, is not.
        """
        texts: list[tuple[float, str]] = []
        spread = cable_prior(self.joints).spread
        for j, name in enumerate(self.joints):
            for k, other in enumerate(self.joints):
                value, std = self.coupling[j][k], self.coupling_std[j][k]
                if abs(value) > max(_CERTAIN * std, _LEAST_COUPLING) and std <= _TOLD * spread[j, k]:
                    acts = f"{other} drags {name}" if j != k else f"{name} is scaled"
                    text = f"{acts} by {np.degrees(value):+z.0f} deg a rad, std {np.degrees(std):.0f}"
                    texts.append((abs(value), text))
            texts += self._play_in_words(j, name, spread[j, len(self.joints) :])
        yield from (text for _, text in sorted(texts, reverse=True))
        if "wander" in self.parts:
            each = ", ".join(
                f"{name} {np.degrees(std):.1f} deg over {time:.0f} s"
                for name, std, time in zip(self.joints, self.wander, self.seconds, strict=True)
            )
            yield f"wander: {each}"

    def _play_in_words(self, j: int, name: str, spread: Float64) -> Iterator[tuple[float, str]]:
        """Yield what play does to one joint, with its size; ``spread`` (C + 1,) is expected of its coefficients."""
        for k, other in enumerate(self.joints):
            gain, variance, usual = self.play[j][k], self.play_std[j][k] ** 2, spread[k] ** 2
            if j == k:
                gain, variance = gain + NARROW * self.narrow[j], variance + (NARROW * self.narrow_std[j]) ** 2
                usual += (NARROW * spread[-1]) ** 2
            size, std = abs(gain) * self.width[k], variance**0.5 * self.width[k]
            if size > max(_CERTAIN * std, _LEAST_PLAY) and variance <= _TOLD**2 * usual:
                acts = f"{name} stays behind its reading" if j == k else f"play of {other} moves {name}"
                yield abs(gain), f"{acts} by up to {np.degrees(size):.0f} deg, std {np.degrees(std):.0f}"


def _row(values: Float64) -> Row:
    return tuple(rounded_array(values))


def _table(values: Float64) -> Table:
    return tuple(_row(row) for row in values)
