"""Values as messages show them: on one line and short, whatever a file holds."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

_LONGEST = 60


def shown(value: Any) -> str:
    """Show a value as Python would write it, cut where it grows too long; ``nothing`` for None."""
    if value is None:
        return "nothing"
    text = repr(value[: 2 * _LONGEST] if isinstance(value, str) else value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


def listed(names: Iterable[str], most: int = 5) -> str:
    """List the first few of many names."""
    names = list(names)
    first = [shown(name)[1:-1] for name in names[:most]]
    return ", ".join(first) + (", ..." if len(names) > most else "")
