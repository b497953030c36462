"""Classes of documents, used by several threads: msgspec looks up the fields of a class when it first meets it.

msgspec 0.22 crashes the process if two threads let it do so for the same class at the same time.
"""

from __future__ import annotations

import threading
from typing import Any, TypeVar

from msgspec.json import Decoder

T = TypeVar("T")

_preparing = threading.Lock()
_prepared: set[Any] = set()


def prepared(kind: type[T]) -> type[T]:
    """Return a class whose fields msgspec knows, so that threads can use it."""
    if kind not in _prepared:
        with _preparing:
            Decoder(kind)
            _prepared.add(kind)
    return kind
