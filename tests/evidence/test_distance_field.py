"""Fast marching by the compiled function of scikit-fmm, as by its public one."""

from __future__ import annotations

import subprocess
import sys

import cv2
import numpy as np
import pytest
from skfmm import pfmm

from dvrk_cmaes.evidence.distance_field import distance_field

MASK = cv2.ellipse(np.zeros((60, 80), np.uint8), (30, 20), (25, 9), 30.0, 0, 360, 1, -1) > 0
NEAR = cv2.dilate(MASK.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0


@pytest.mark.parametrize("where", [None, NEAR])
def test_distances_are_those_of_the_public_function(where: np.ndarray | None, monkeypatch: pytest.MonkeyPatch) -> None:
    found = distance_field(MASK, where=where)
    exact = distance_field(MASK, "exact")
    np.testing.assert_allclose(found[NEAR], exact[NEAR], atol=0.8)

    def other(*_: object) -> None:
        raise TypeError("takes 11 positional arguments")

    called = []
    public = pfmm.distance

    def distance(*given: object, **named: object) -> object:
        called.append(named)
        monkeypatch.undo()  # it calls the compiled function itself
        return public(*given, **named)

    monkeypatch.setattr(pfmm, "cFastMarcher", other)
    monkeypatch.setattr(pfmm, "distance", distance)
    np.testing.assert_array_equal(distance_field(MASK, where=where), found)
    assert len(called) == 1


def test_masked_arrays_are_not_imported() -> None:
    """Their import takes a twentieth of the processor time of a whole command."""
    code = (
        "import sys, numpy as np; from dvrk_cmaes.evidence.distance_field import distance_field;"
        "distance_field(np.eye(20) > 0); print('numpy.ma' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
