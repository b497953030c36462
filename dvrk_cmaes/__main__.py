"""Entry point of ``dvrk-cmaes`` and of ``python -m dvrk_cmaes``.

It imports little, so that Ctrl-C ends the program with one line as soon as Python has started.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
from collections.abc import Callable, Iterable
from types import FrameType

_INTERRUPTED = 130
_LEAST_MEMORY = 1_000_000_000  # bytes of address space; with fewer, libraries end the process without a message


def main() -> int:
    """Run the command line of ``sys.argv`` and return its exit code; SIGTERM and SIGHUP have the effect of Ctrl-C."""
    defaults = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
        signal.SIGHUP: signal.SIG_DFL,
    }
    ours = [number for number, handler in defaults.items() if signal.getsignal(number) is handler]  # others are ignored
    _handle(ours, _end)
    _prepare_libraries()
    if 0 <= (limit := resource.getrlimit(resource.RLIMIT_AS)[0]) < _LEAST_MEMORY:
        least, given = (f"{size // 1024} kB" for size in (_LEAST_MEMORY, limit))
        os.write(2, f"dvrk-cmaes: expected a limit of at least {least} of memory, got {given} (ulimit -v)\n".encode())
        return 1
    try:
        from dvrk_cmaes.cli import main as run_command_line

        _handle(ours, _interrupt)
        return run_command_line()
    except KeyboardInterrupt:  # before or after the command line's own handling of it
        _end(signal.SIGINT, None)
        raise
    finally:
        _handle(ours, _end)  # while threads and modules are taken down, as while they are imported


def _prepare_libraries() -> None:
    """Open the null device for standard streams that are closed, and keep OpenCV's log off stdout.

    Otherwise the first files that are opened would get their descriptors, and what native code prints. Child processes
    inherit both.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest that is free: this one
    if os.environ.get("OPENCV_LOG_LEVEL", "").upper() in ("I", "INFO", "D", "DEBUG", "V", "VERBOSE", "4", "5", "6"):
        os.environ["OPENCV_LOG_LEVEL"] = "WARNING"  # above that, OpenCV writes to stdout


def _handle(numbers: Iterable[int], handler: Callable[[int, FrameType | None], None]) -> None:
    for number in numbers:
        signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, or end the process while a library is imported, such as trimesh, which catches it."""
    at = frame
    while at is not None:
        if at.f_code.co_filename.startswith("<frozen importlib"):
            _end(number, frame)
        at = at.f_back
    raise KeyboardInterrupt


def _end(number: int, frame: FrameType | None) -> None:
    """End the process at once, with the line and the exit code of an interrupted command."""
    os.write(2, b"dvrk-cmaes: interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
