"""Median and quantiles without numpy.ma."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from dvrk_cmaes.evidence.quantiles import median, quantile


@pytest.mark.parametrize("count", [1, 2, 3, 4, 9, 500, 501])
def test_median_is_that_of_numpy(count: int) -> None:
    rng = np.random.default_rng(count)
    for values in (rng.normal(size=count), rng.integers(50, size=count), rng.normal(size=count).astype(np.float32)):
        assert median(values) == float(np.median(values))
        for share in (0.0, 0.05, 0.5, 0.95, 1.0):
            assert quantile(values.astype(np.float64), share) == float(np.quantile(values.astype(np.float64), share))


def test_masked_arrays_are_not_imported() -> None:
    code = (
        "import sys, numpy as np; from dvrk_cmaes.evidence.quantiles import median, quantile;"
        "median(np.arange(4.0)); quantile(np.arange(4.0), 0.3); print('numpy.ma' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
