"""A Dask cluster as the executor of a batch; needs the extra ``cluster``."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.config import __version__
from dvrk_cmaes.errors import DvrkCmaesError, InputError, missing_library
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.runs.pool import Executors

_ADDRESS: Final = re.compile(r"(?:tcp://)?(\[[0-9a-fA-F:.]+\]|[\w.-]+):(\d{1,5})")
CONNECT_S: Final = 15  # s, for the connection to the scheduler, and then for its first worker


@contextmanager
def dask_executor(address: str, folder: str | Path) -> Iterator[Executors]:
    """Return a context manager that connects to a Dask scheduler and gives its workers as an executor.

    Workers may join and leave during the run. If a worker dies, its frames are given to other workers. A frame on
    which more workers have died than the scheduler's setting ``allowed-failures`` (3 by default) is given up.

    Parameters
    ----------
    address
        Address of the scheduler, e.g. ``tcp://host:8786``.
    folder
        Folder of the session, which the workers must find under the same path.

    Raises
    ------
    InputError
        Dask is not installed, there is no scheduler at the address, a worker has another version of this package, or a
        worker does not find the folder.
    DvrkCmaesError
        The scheduler has no workers.
    """
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise missing_library("--scheduler", "distributed") from None
    connect: Any = Client  # Dask has no type annotations
    try:
        _check_address(address)
        client = connect(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler: expected a Dask scheduler's address, got {shown(address)}: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise DvrkCmaesError(f"--scheduler: {address} has no workers") from None
        _check_workers(client, Path(folder).absolute())

        def at_once() -> int:
            # One task a thread. The scheduler counts a worker's death against every task the worker holds: a task that
            # waits behind one that kills its workers would be given up with it.
            return max(1, int(sum(client.nthreads().values())))

        yield Executors(client.get_executor(pure=False), at_once, (KilledWorker,))


def _check_address(address: str) -> None:
    """Raise ValueError for no address, OSError where nothing answers, before Dask tries for long and prints much."""
    parts = _ADDRESS.fullmatch(address)
    if parts is None:
        raise ValueError("expected tcp://HOST:PORT")
    if int(parts[2]) not in range(1, 2**16):
        raise ValueError("expected a port from 1 to 65535")
    socket.create_connection((parts[1].strip("[]"), int(parts[2])), timeout=CONNECT_S).close()


def _check_workers(client: Any, folder: Path) -> None:
    """Check that all workers have this version of the package and find the folder; raises `InputError`."""
    answers = client.run(_version_and_access, str(folder), on_error="return")
    for worker, answer in answers.items():
        if isinstance(answer, BaseException):
            raise InputError(f"--scheduler: worker {worker}: expected dvrk-cmaes {__version__} there, got {answer}")
        version, has_access = answer
        if version != __version__:
            raise InputError(f"--scheduler: worker {worker}: expected dvrk-cmaes {__version__}, got {version}")
        if not has_access:
            raise InputError(f"--scheduler: worker {worker} does not see {folder}: expected it under the same path")


def _version_and_access(folder: str) -> tuple[str, bool]:
    """Return the version of the package in this process, and whether a folder is found."""
    return __version__, Path(folder).is_dir()
