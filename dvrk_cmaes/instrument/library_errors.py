"""The messages of other libraries' errors, made fit for one line of ours."""

from __future__ import annotations

_LONGEST = 200


def one_line(error: BaseException) -> str:
    """Return what an error says on one line, at most 200 characters long; its kind if it says nothing."""
    text = " ".join(str(error).split())
    if isinstance(error, KeyError):
        text = f"{text} is missing"
    text = text or type(error).__name__
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
