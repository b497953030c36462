"""Functions for tests of worker processes; a worker imports this module to unpickle them."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import signal
import time
from pathlib import Path

import cv2

from dvrk_cmaes import InputError


def prepare_nothing() -> None:
    """Prepare a process that needs no preparation."""


def die() -> None:
    """Kill the process that calls this."""
    os.kill(os.getpid(), signal.SIGKILL)


def process_id(task: int) -> int:
    """Return the id of the process that calls this."""
    return os.getpid()


def process_id_after_pause(task: int) -> int:
    """Return the id of the process that calls this, after a hundredth of a second."""
    time.sleep(0.01)
    return os.getpid()


def library_threads(task: int) -> int:
    """Return the number of threads that OpenCV uses in the process that calls this."""
    return cv2.getNumThreads()


def refuse(task: int) -> int:
    """Raise an error that names the task."""
    raise InputError(f"refused {task}")


def squared(task: int) -> int:
    """Square a number."""
    return task * task


def squared_unless_three(task: int) -> int:
    """Square a number, but kill the process on 3."""
    if task == 3:
        die()
    return task * task


def hang_in_native_code(seconds: float, task: int) -> int:
    """Return the task, but for 0 hold the interpreter in native code; the process is ended after some seconds."""
    if task == 0:
        faulthandler.dump_traceback_later(seconds, exit=True, file=open(os.devnull, "wb"))  # noqa: SIM115
        ctypes.PyDLL(None).sleep(100)
    return task


def squared_after_gate(task: tuple[int, Path]) -> int:
    """Square a number; other numbers than 0 wait until the file ``gate`` exists."""
    number, gate = task
    while number and not gate.exists():
        time.sleep(0.01)
    return number * number


def squared_with_faults(notes: Path, task: int) -> int:
    """Square a number, but kill the process on multiples of 7 and on the first try of 5, and hang on 11.

    Each try appends the process id to the file ``notes/{task}``.
    """
    with (notes / str(task)).open("a") as tried:
        tried.write(f"{os.getpid()}\n")
    if task % 7 == 0 or (task == 5 and len((notes / "5").read_text().split()) == 1):
        die()
    if task == 11:
        time.sleep(100)
    return task * task
