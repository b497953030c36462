"""Print in one line what is missing to install the package: Python's version, venv, a C++ compiler, Python's headers.

The package's kernel is compiled by CMake, which comes as a wheel, and one dependency, scikit-fmm, which has no wheels
for Linux, by Meson. The script runs on any Python 3 without packages.
"""

import os
import shutil
import sys
import sysconfig

OLDEST = (3, 11)
COMPILERS = {"CC": ("cc", "gcc", "clang"), "CXX": ("c++", "g++", "clang++")}
"""Programs that CMake and Meson try for C and C++, unless the variable of the environment names one."""


def missing() -> "list[str]":
    """Return descriptions of what is missing; an empty list if nothing is."""
    found = []
    version = sys.version_info[:2]
    if version < OLDEST:
        found.append(f"Python 3.11 or later (this is {version[0]}.{version[1]}; name another one by PYTHON=...)")
    try:
        import ensurepip  # noqa: F401
        import venv  # noqa: F401
    except ImportError:
        found.append("Python's venv (Debian: apt install python3-venv)")
    if not all(_compiler_found(variable) for variable in COMPILERS):
        found.append("a C++ compiler (Debian: apt install g++)")
    if not os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h")):
        found.append("Python's headers (Debian: apt install python3-dev)")
    return found


def _compiler_found(variable: str) -> bool:
    """Return whether the compiler that a variable of the environment names, or else one of the usual ones, is there."""
    named = os.environ.get(variable, "").split()[:1]
    return any(shutil.which(name) for name in named or COMPILERS[variable])


if __name__ == "__main__":
    lacking = missing()
    if lacking:
        sys.exit("cannot install: missing " + "; ".join(lacking))
