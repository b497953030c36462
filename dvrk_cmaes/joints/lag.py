"""The lag of a recording's images behind its joint readings.

The lag is positive if the images are late: the image of time t shows the arm as it was read at t - lag.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.encode import rounded
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.io.typed_document import Number

Unit = Literal["s", "frames"]

SIGN = "images late"
LARGEST_SECONDS, LARGEST_FRAMES = 60.0, 1800.0
"""Largest magnitudes of a lag that is given by hand."""

_TEXT = re.compile(r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?) ?(s|frames?)?")


@dataclass(frozen=True)
class Lag:
    """Lag of the images behind the readings, in frames, in seconds, or in both.

    ``std_frames`` and ``std_seconds`` are its standard deviations. ``applied``: whether the lag was taken out of the
    readings; a lag that does not differ significantly from zero is not.
    """

    frames: Number | None = None
    std_frames: Number | None = None
    seconds: Number | None = None
    std_seconds: Number | None = None
    applied: bool = True

    @classmethod
    def of(cls, value: float, std: float, unit: Unit, interval: float, *, applied: bool) -> Lag:
        """Create a lag from a value and standard deviation in a unit, and the time between images in that unit.

        Parameters
        ----------
        value
            The lag, in ``unit``.
        std
            Its standard deviation, in ``unit``.
        unit
            ``s`` or ``frames``.
        interval
            Time between images, in ``unit``.
        applied
            Whether it was taken out of the readings.
        """
        seconds, std_seconds = (value, std) if unit == "s" else (None, None)
        return cls(value / interval, std / interval, seconds, std_seconds, applied)

    @classmethod
    def parse(cls, option: str, text: str) -> Lag:
        """Parse a lag such as ``0.13``, in seconds, or ``4frames``; InputError names the option.

        Parameters
        ----------
        option
            Name of the option, for the message.
        text
            The lag as it was given.
        """
        match = _TEXT.fullmatch(text.strip())
        if match is None:
            expected = "a number of seconds such as 0.13, or of frames such as 4frames"
            raise InputError(f"{option}: expected {expected}, got {shown(text)}")
        value = float(match[1])
        if value == 0:
            return cls(0.0, seconds=0.0)
        in_frames = (match[2] or "s").startswith("frame")
        most = LARGEST_FRAMES if in_frames else LARGEST_SECONDS
        if abs(value) > most:
            unit = "frames" if in_frames else "seconds"
            raise InputError(f"{option}: expected at most {most:g} {unit} in magnitude, got {shown(text)}")
        return cls(value) if in_frames else cls(None, seconds=value)

    def to_dict(self) -> dict[str, Any]:
        """Return the lag in the documented schema, ready for JSON."""
        values = {name: value for name, value in vars(self).items() if value is not None and name != "applied"}
        return {**{name: rounded(value) for name, value in values.items()}, "sign": SIGN, "applied": self.applied}

    def in_unit(self, unit: Unit) -> float:
        """Return the lag in a unit; InputError if it is not known in this unit.

        Parameters
        ----------
        unit
            ``s`` or ``frames``.
        """
        value = self.seconds if unit == "s" else self.frames
        if value is not None:
            return value
        expected = "seconds, such as 0.13" if unit == "s" else "frames, such as 4frames"
        why = "have times" if unit == "s" else "have no times"
        raise InputError(f"lag: expected a lag in {expected}, since the images {why}, got {self.text}")

    def known_in(self, unit: Unit) -> tuple[float | None, float | None]:
        """Return the lag and its standard deviation in a unit, None where they are not known in it.

        Parameters
        ----------
        unit
            ``s`` or ``frames``.
        """
        return (self.seconds, self.std_seconds) if unit == "s" else (self.frames, self.std_frames)

    def in_seconds(self, rate: float) -> float:
        """Return the lag in seconds, for a recording with a number of frames a second.

        Parameters
        ----------
        rate
            Frames a second.
        """
        return self.seconds if self.seconds is not None else (self.frames or 0.0) / rate

    def describe(self) -> str:
        """Describe the lag in words: its amount in frames and seconds, its sign, and its standard deviation."""
        value = self.frames if self.frames is not None else self.seconds
        assert value is not None
        seconds = None if self.seconds is None else f"{abs(self.seconds):.3f} s"
        amount = f"{abs(self.frames):.2f} frames" if self.frames is not None else seconds
        if self.frames is not None and seconds is not None:
            amount = f"{amount} ({seconds})"
        std = "" if self.std_frames is None else f", std {self.std_frames:.2f} frames"
        return f"images are {amount} {'later' if value > 0 else 'earlier'} than the readings{std}"

    @property
    def text(self) -> str:
        """The lag with its unit: ``0.131 s`` or ``3.94 frames``."""
        value, unit = (self.seconds, "s") if self.seconds is not None else (self.frames, "frames")
        return f"{round(value or 0.0, 3 if unit == 's' else 2):g} {unit}"

    @property
    def option(self) -> str:
        """The lag as an option of the command line: ``--lag 0.131s`` or ``--lag 3.94frames``."""
        return f"--lag {self.text.replace(' ', '')}"
