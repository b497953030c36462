"""Exceptions of the package.

Each has the exit code of the command line. Its message is one line that names the file, the field and what was
expected.
"""

from __future__ import annotations

import difflib
import shlex
import sys
import traceback
from collections.abc import Iterable
from pathlib import Path


class DvrkCmaesError(Exception):
    """Base class of the package's exceptions: a failure other than wrong input (exit code 1)."""

    exit_code = 1


class InputError(DvrkCmaesError):
    """Wrong usage or input (exit code 2); the message names the file, the field and what was expected."""

    exit_code = 2


def missing_library(what: str, library: str) -> InputError:
    """Return the error where an optional library is not installed; it states the command for this environment.

    Parameters
    ----------
    what
        What needs it.
    library
        Its name in the package's extras.
    """
    from importlib.metadata import requires

    needed = next(each.partition(";")[0] for each in requires("dvrk-cmaes") or () if each.startswith(library))
    command = shlex.join([sys.executable, "-m", "pip", "install", needed])
    return InputError(f"{what}: needs the library {library}, which is not installed; run: {command}")


def nearest_first(name: str, known: Iterable[str]) -> list[str]:
    """Sort known names by their similarity to a mistyped name, most similar first."""
    return sorted(known, key=lambda k: -difflib.SequenceMatcher(None, name, k).ratio())


_LONGEST = 200


def one_line(error: BaseException) -> str:
    """Return the message of an exception as one line of at most 200 characters; the class name if it has none."""
    text = " ".join(str(error).split())
    if isinstance(error, KeyError):
        text = f"{text} is missing"
    text = text or type(error).__name__
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


def internal_error(error: BaseException) -> str:
    """Say of an exception that nothing expects what it is, where it was raised, and its message, in one line."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"internal error: {type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {one_line(error)}"
