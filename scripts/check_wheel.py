"""Run `dvrk-cmaes demo` with the installed package, and check that it reads no file outside the package and Python.

    cd SOMEWHERE_ELSE && ENVIRONMENT/bin/python CHECKOUT/scripts/check_wheel.py

What Python opens and lists is recorded by an audit hook; what libraries in C open by themselves is not seen. Files that
the run itself wrote, the cache of measured instruments, and those of the system below /dev, /proc and /sys may be read;
folders in which Python looks for modules may be listed.
The exit code is 1 if other files were read, or another process was started, whose files would not be seen.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

_READS: Final = frozenset({"open", "os.listdir", "os.scandir"})
_STARTS: Final = frozenset({"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.exec", "os.system"})
_SYSTEM: Final = ("/dev", "/proc", "/sys")
_WRITING: Final = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class Record:
    """The files that were read and written, by absolute path, and the processes that were started."""

    def __init__(self) -> None:
        self.read: list[str] = []
        self.written: set[str] = set()
        self.started: list[str] = []

    def hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Record an event; an audit hook."""
        if event in _STARTS:
            self.started.append(event)
        elif _is_within_open_folder(event, arguments):
            return
        elif event in _READS and arguments and isinstance(arguments[0], str | bytes | os.PathLike):
            path = os.path.abspath(os.fsdecode(arguments[0]))
            if event == "open" and isinstance(arguments[2], int) and arguments[2] & _WRITING:
                self.written.add(path)
            elif path not in self.written:
                self.read.append(path)


def _is_within_open_folder(event: str, arguments: tuple[Any, ...]) -> bool:
    """Return whether an event opens a folder itself, or what is in a folder that is open already.

    The audit hook does not see which folder that is. The package writes in this way, and never through links; it lists
    folders by `os.fwalk`, which opens them by relative names that are no files of the working directory.
    """
    if event != "open" or arguments[1] is not None or not isinstance(arguments[2], int):
        return False
    name = os.fsdecode(arguments[0])
    within = not os.path.isabs(name) and (arguments[2] & os.O_NOFOLLOW or not os.path.isfile(name))
    return bool(within or arguments[2] & os.O_DIRECTORY)


def outside(read: Iterable[str], allowed: Iterable[str]) -> list[str]:
    """Return the paths that are in none of the allowed folders, sorted, each once."""
    folders = {os.path.realpath(folder) for folder in allowed} | set(allowed)
    return sorted(
        {path for path in read if not any(path == folder or path.startswith(folder + os.sep) for folder in folders)}
    )


def main() -> int:
    """Run the demo in the working directory, print what it should not have read, and return the exit code."""
    record = Record()
    sys.addaudithook(record.hook)
    from dvrk_cmaes.cli import main as command

    code = command(["demo"])
    import dvrk_cmaes
    from dvrk_cmaes.io.files import bundled_path, cache_folder

    allowed = {
        sys.prefix,
        sys.base_prefix,
        *sysconfig.get_paths().values(),
        *(folder for folder in sys.path if folder.endswith("site-packages")),
        str(Path(dvrk_cmaes.__file__).parent),
        str(bundled_path()),
        str(cache_folder() or dvrk_cmaes.__path__[0]),
        str(Path("dvrk-cmaes-demo").absolute()),
        *_SYSTEM,
    }
    wrong = [path for path in outside(record.read, allowed) if path not in sys.path]
    print(*(f"read outside the package: {path}" for path in wrong), sep="\n", end="\n" if wrong else "")
    print(*(f"started: {event}" for event in record.started), sep="\n", end="\n" if record.started else "")
    return code or int(bool(wrong or record.started))


if __name__ == "__main__":
    sys.exit(main())
