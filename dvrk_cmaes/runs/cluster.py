"""A Dask cluster as the workers of a batch: the scheduler's address in, an executor out (extra ``cluster``)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes._version import __version__
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.runs.executor import Elsewhere

_CONNECT: Final = 15  # seconds to find the scheduler, and then its first worker
_AHEAD: Final = 2  # tasks a thread, so that none waits for us


@contextmanager
def dask_executor(address: str, folder: str | Path) -> Iterator[Elsewhere]:
    """Connect to the scheduler at an address and give its workers as an executor, until the block is left.

    Workers may come and go meanwhile. A frame whose worker dies is done by another; after the scheduler's
    ``allowed-failures`` (3 unless configured otherwise) it is given up.

    Parameters
    ----------
    address
        As Dask writes it, ``tcp://host:8786``.
    folder
        The session's; the workers must see it under the same path.

    Raises
    ------
    InputError
        Dask is not installed, there is no scheduler, or a worker has another version or does not see the folder.
    DvrkCmaesError
        The scheduler has no workers.
    """
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise InputError(f"--scheduler: Dask is missing ({error}); pip install 'dvrk-cmaes[cluster]'") from None
    connect: Any = Client  # has no types
    try:
        client = connect(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler: expected a Dask scheduler's address, got {shown(address)}: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_CONNECT)
        except TimeoutError:
            raise DvrkCmaesError(f"--scheduler: {address} has no workers") from None
        _check_workers(client, Path(folder).absolute())

        def at_once() -> int:
            return _AHEAD * max(1, int(sum(client.nthreads().values())))

        yield Elsewhere(client.get_executor(pure=False), at_once, (KilledWorker,))


def _check_workers(client: Any, folder: Path) -> None:
    """Refuse workers that would give other results, or none."""
    found = client.run(_what_a_worker_has, str(folder), on_error="return")
    for worker, answer in found.items():
        if isinstance(answer, BaseException):
            raise InputError(f"--scheduler: worker {worker}: expected dvrk-cmaes {__version__} there, got {answer}")
        version, sees = answer
        if version != __version__:
            raise InputError(f"--scheduler: worker {worker}: expected dvrk-cmaes {__version__}, got {version}")
        if not sees:
            raise InputError(f"--scheduler: worker {worker} does not see {folder}: expected it under the same path")


def _what_a_worker_has(folder: str) -> tuple[str, bool]:
    return __version__, Path(folder).is_dir()
