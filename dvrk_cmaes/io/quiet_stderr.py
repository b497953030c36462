"""Capture of what native libraries print to the error stream themselves, such as libpng, libjpeg and ONNX Runtime."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_LONGEST = 10_000  # bytes that are kept
_one_at_a_time = threading.RLock()


@contextmanager
def native_messages() -> Iterator[list[str]]:
    """Keep the lines that native code prints to the error stream meanwhile out of it; they are in the list at the end.

    Threads do this one after the other. Where the process has no error stream, nothing is captured.
    """
    lines: list[str] = []
    with _one_at_a_time, tempfile.TemporaryFile() as file:
        try:
            saved = os.dup(2)
        except OSError:
            yield lines
            return
        sys.stderr.flush()
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            file.seek(0)
            lines += file.read(_LONGEST).decode(errors="replace").splitlines()
