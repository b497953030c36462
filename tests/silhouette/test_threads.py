"""Threads of independent items, and the limit of BLAS to one thread."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

from dvrk_cmaes.silhouette.threads import map_threaded, single_blas_thread


def blas_threads() -> set[int]:
    libraries = ThreadpoolController().select(user_api="blas").info()
    return {int(library["num_threads"]) for library in libraries}


@pytest.fixture
def two_blas_threads() -> Iterator[None]:
    with threadpool_limits(limits=2, user_api="blas"):
        yield


@pytest.mark.usefixtures("two_blas_threads")
def test_blas_is_limited_until_the_last_caller_leaves() -> None:
    first, second = single_blas_thread(), single_blas_thread()
    first.__enter__()
    second.__enter__()
    assert blas_threads() == {1}
    first.__exit__(None, None, None)
    assert blas_threads() == {1}
    second.__exit__(None, None, None)
    assert blas_threads() == {2}


@pytest.mark.usefixtures("two_blas_threads")
def test_blas_is_released_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), single_blas_thread():
        raise ZeroDivisionError
    assert blas_threads() == {2}


@pytest.mark.parametrize("threads", [1, 3])
def test_values_are_in_the_order_of_their_items(threads: int) -> None:
    assert map_threaded(lambda x: x * x, range(20), threads) == [x * x for x in range(20)]
