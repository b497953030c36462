"""A process that is prepared for a long run: threads share its memory, and collections leave out what was there."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

CODE = """
import gc, threading
from dvrk_cmaes.runs.live_session import prepare_long_run
import numpy as np
prepare = {prepare}
if prepare:
    prepare_long_run()
    assert gc.get_freeze_count() > 1000
def work():
    kept = [np.ones(1000) for _ in range(100)]
    together.wait()
together = threading.Barrier(5)
threads = [threading.Thread(target=work) for _ in range(4)]
for thread in threads: thread.start()
together.wait()
for thread in threads: thread.join()
import ctypes
ctypes.CDLL(None).malloc_stats()
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have no arenas")
@pytest.mark.parametrize("prepare", [False, True])
def test_threads_share_one_arena(*, prepare: bool) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(prepare=prepare)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (done.stderr.count("Arena ") == 1) is prepare


GIVES_BACK = """
import psutil
from dvrk_cmaes.runs.live_session import give_back_memory, prepare_long_run
prepare_long_run()
both = [(b"x" * 100_000, bytearray(30_000)) for _ in range(500)]
kept = [small for _, small in both]
del both
before = psutil.Process().memory_info().rss
give_back_memory()
print((before - psutil.Process().memory_info().rss) / 1e6)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries do not give memory back")
def test_memory_between_what_is_kept_is_given_back() -> None:
    done = subprocess.run([sys.executable, "-c", GIVES_BACK], capture_output=True, text=True, check=True)
    assert float(done.stdout) > 25
