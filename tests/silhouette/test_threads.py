"""The limit of BLAS to one thread."""

from __future__ import annotations

import subprocess
import sys

import pytest

LIMITED = """
first, second = single_blas_thread(), single_blas_thread()
first.__enter__()
second.__enter__()
assert blas_threads() == {1}
first.__exit__(None, None, None)
assert blas_threads() == {1}
second.__exit__(None, None, None)
assert blas_threads() == {2}
"""

AFTER_AN_ERROR = """
try:
    with single_blas_thread():
        1 / 0
except ZeroDivisionError:
    pass
assert blas_threads() == {2}
"""

IN_OTHER_THREADS = """
with single_blas_thread():
    pass
with ThreadPoolExecutor(1) as threads:
    begin, end = threads.submit, ThreadPoolExecutor(1).submit
    for _ in range(2):
        limit = single_blas_thread()
        begin(limit.__enter__).result()
        assert blas_threads() == {1}
        end(limit.__exit__, None, None, None).result()
        assert blas_threads() == {2}
"""

SETUP = """
from concurrent.futures import ThreadPoolExecutor
from threadpoolctl import ThreadpoolController, threadpool_limits
from dvrk_cmaes.silhouette.threads import single_blas_thread

def blas_threads():
    libraries = ThreadpoolController().select(user_api="blas").info()
    return {int(library["num_threads"]) for library in libraries}

threadpool_limits(limits=2, user_api="blas")
"""


@pytest.mark.parametrize(
    "code",
    [LIMITED, AFTER_AN_ERROR, IN_OTHER_THREADS],
    ids=["until the last caller leaves", "not after an error", "whichever threads begin and end it"],
)
def test_blas_is_limited(code: str) -> None:
    """In a process of its own: the limit is the process's, and threads of other tests may need it."""
    ran = subprocess.run([sys.executable, "-c", SETUP + code], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
