"""Errors a person can act on.

Every error carries the exit code that the command line ends with. Messages are one line that names the
file, the field and what was expected.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class DvrkCmaesError(Exception):
    """Base of all errors raised on purpose: the work could not be done (exit code 1)."""

    exit_code = 1


class InputError(DvrkCmaesError):
    """Wrong usage or input (exit code 2): the message says where, which field, and what was expected."""

    exit_code = 2


def nearest_first(name: str, known: Iterable[str]) -> list[str]:
    """Sort the known names by likeness to a mistyped one, the most alike first."""
    return sorted(known, key=lambda k: -difflib.SequenceMatcher(None, name, k).ratio())


_LONGEST = 200


def one_line(error: BaseException) -> str:
    """Return what an error says on one line, at most 200 characters long; its kind if it says nothing."""
    text = " ".join(str(error).split())
    if isinstance(error, KeyError):
        text = f"{text} is missing"
    text = text or type(error).__name__
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
