"""Processes in which an instrument is prepared once, for batches and calibrations.

This module imports little, so that the processes can start while the program that needs them is imported.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence, Sized
from typing import TYPE_CHECKING, Any

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.runs.processes import Processes, WorkerDied

if TYPE_CHECKING:
    from dvrk_cmaes.config import EstimateConfig
    from dvrk_cmaes.instrument import Instrument
    from dvrk_cmaes.silhouette import Body

_PAYS = 4
"""Frames of a calibration from which on one process more is sooner done: its start takes the time of about two."""


def worker_processes(instrument: Instrument, workers: int) -> Processes:
    """Return worker processes for `run_batch` and then `solving_folder`."""
    return Processes(functools.partial(_start, instrument), workers)


def instrument_processes(instrument: Instrument, workers: int, frames: Sized) -> Processes:
    """Return processes for `solving_folder`: this one and up to ``workers`` - 1 others, none for few frames."""
    return Processes(functools.partial(_start, instrument), processes_beside(workers, len(frames)), here=True)


def processes_beside(workers: int, frames: int) -> int:
    """Return the number of processes beside this one with which a calibration is soonest done."""
    return min(workers - 1, frames // _PAYS)


def run_with_body(
    processes: Processes,
    key: str,
    config: EstimateConfig,
    function: Callable[[Body, EstimateConfig, Any], Any],
    tasks: Sequence[Any],
) -> list[Any]:
    """Return the values of a function of body, settings and task, in the order of the tasks.

    ``key`` is the digest of the instrument that is prepared in the processes.

    Raises
    ------
    DvrkCmaesError
        A process died.
    """
    values = {}
    for (number, _), value in processes.run(enumerate(tasks), functools.partial(_call, key, config, function)):
        if isinstance(value, WorkerDied):
            raise DvrkCmaesError(f"frame {number + 1} of {len(tasks)}: {value.reason}: try fewer --workers")
        values[number] = value
    return [values[number] for number in range(len(tasks))]


def _start(instrument: Instrument) -> None:
    """Build the instrument's scenes in a process, and import what its tasks need; scenes cannot be sent back."""
    import dvrk_cmaes.runs.calibration_pictures  # noqa: F401
    from dvrk_cmaes.runs.worker import prepare_instrument

    prepare_instrument(instrument)


def _call(
    key: str, config: EstimateConfig, function: Callable[[Body, EstimateConfig, Any], Any], numbered: tuple[int, Any]
) -> Any:
    from dvrk_cmaes.runs.worker import prepared_body

    return function(prepared_body(key), config, numbered[1])
