"""Checkouts whose commands are run in processes of their own."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dvrk_cmaes.errors import InputError

_FINISHED: Final = (0, 3)  # exit codes of a command that has estimated its frames


@dataclass(frozen=True)
class Checkout:
    """A checkout whose package is imported by processes of its own environment, compiled into the folder ``compiled``.

    That of another environment would not do: an editable package is found before the folders of PYTHONPATH. ``cache``
    is the folder in which its commands keep the instruments that they have measured.
    """

    folder: Path
    compiled: str
    cache: str

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables of its processes."""
        given = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        return {**given, **one, "PYTHONPYCACHEPREFIX": self.compiled}

    def run(self, arguments: Sequence[str], folder: Path, **variables: str) -> int:
        """Run a command in a folder, and return its exit code; InputError if it has not estimated its frames."""
        done = subprocess.run(
            [self.folder / ".venv" / "bin" / "python", "-m", "dvrk_cmaes", *arguments],
            env=self.environment | variables,
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode not in _FINISHED:
            said = done.stderr.strip()[-300:]
            raise InputError(f"{self.folder}: dvrk-cmaes {' '.join(arguments)}: {said}")
        return done.returncode


def interpreter_of(folder: Path) -> Path | None:
    """Return the interpreter of a checkout's environment; None where that does not import the checkout's package."""
    python, code = folder / ".venv" / "bin" / "python", "import dvrk_cmaes; print(dvrk_cmaes.__file__)"
    if not python.exists():
        return None
    found = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False, cwd="/").stdout.strip()
    return python if found == str(folder / "dvrk_cmaes" / "__init__.py") else None


@contextmanager
def two_checkouts(this: Path, other: Path) -> Iterator[tuple[Checkout, Checkout]]:
    """Yield the checkout of --checkout and that of --against; InputError if the environment of one has not its package.

    What one has compiled serves both, and also later comparisons, if PYTHONPYCACHEPREFIX names a folder for that.
    """
    for option, folder in (("--checkout", this), ("--against", other)):
        if interpreter_of(folder.resolve()) is None:
            raise InputError(
                f"{option} {folder}: expected a checkout whose .venv has its package, as `make demo` makes it"
            )
    with tempfile.TemporaryDirectory() as made:
        once = os.environ.get("PYTHONPYCACHEPREFIX", f"{made}/once")
        yield Checkout(this.resolve(), once, f"{made}/cache of this"), Checkout(other.resolve(), once, f"{made}/cache")
