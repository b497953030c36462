"""Other processors, as far as environment variables let this one compute as they do."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from dvrk_cmaes.errors import InputError

_BLAS: Final = ("Haswell", "Zen", "SkylakeX")
_OPENCV: Final = ("AVX512-SKX", "AVX2", "AVX", "FP16", "SSE4.2", "SSE4.1")
_TOLD: Final = """
import json, sys
import cv2, numpy, scipy.linalg
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__
from threadpoolctl import threadpool_info
json.dump(
    {
        "blas": sorted({one["architecture"] for one in threadpool_info() if one.get("prefix") == "libscipy_openblas"}),
        "opencv": cv2.getCPUFeaturesLine().split(),
        "numpy": [name for name in __cpu_dispatch__ if __cpu_features__.get(name)],
    },
    sys.stdout,
)
"""
"""Prints the BLAS kernels in use, OpenCV's CPU sets (?: not there, or disabled), and those of NumPy that are in use."""


@dataclass(frozen=True)
class Processor:
    """A processor that is imitated: environment variables, and why it cannot be, or what is used, in words."""

    name: str
    variables: Mapping[str, str]
    lacking: str = ""

    @property
    def used(self) -> str:
        """The environment variables, in words."""
        return ", ".join(f"{name}={value}" for name, value in self.variables.items())


def processors() -> list[Processor]:
    """Return all processors that can be told to the libraries, with what this machine lacks for each."""
    own = _told({})
    found = []
    for kernel in _BLAS:
        variables = {"OPENBLAS_CORETYPE": kernel}
        used = _told(variables)["blas"]
        lacking = "" if used == [kernel] else f"not all of the libraries have it: {', '.join(used)}"
        found.append(Processor(f"BLAS {kernel}", variables, lacking))
    there = [name for name in _OPENCV if f"*{name}" in own["opencv"]]
    for name, without in (("AVX-512", 1), ("AVX2", 2), ("AVX", 3), ("SSE 4", len(_OPENCV))):
        disabled = [one for one in _OPENCV[:without] if one in there]
        lacking = "" if _OPENCV[without - 1] in there else f"OpenCV has or takes no {_OPENCV[without - 1]} here"
        found.append(Processor(f"OpenCV without {name}", {"OPENCV_CPU_DISABLE": ",".join(disabled)}, lacking))
    for name, last in (("AVX-512", "X86_V4"), ("AVX2", "X86_V3")):
        disabled = own["numpy"][own["numpy"].index(last) :] if last in own["numpy"] else []
        lacking = "" if disabled else f"NumPy has or takes no {last} here"
        found.append(Processor(f"NumPy without {name}", {"NPY_DISABLE_CPU_FEATURES": " ".join(disabled)}, lacking))
    return found


def _told(variables: Mapping[str, str]) -> dict[str, Any]:
    """Return what the libraries say of the processor with environment variables."""
    command = [sys.executable, "-c", _TOLD]
    done = subprocess.run(command, env={**os.environ, **variables}, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"libraries with {variables}: {done.stderr.strip()[-300:]}")
    return dict(json.loads(done.stdout))
