"""Print in one line what is missing to install the package: Python's version, venv, a C++ compiler, Python's headers.

The package's kernel is compiled by CMake, which comes as a wheel, and one dependency, scikit-fmm, which has no wheels
for Linux, by Meson. The script runs on any Python 3 without packages.
"""

import importlib.util
import os
import shutil
import sys
import sysconfig


def has_compiler(variable: str, *usual: str) -> bool:
    """Return whether the compiler that a variable of the environment names, or else one of the usual ones, is there."""
    return any(shutil.which(name) for name in os.environ.get(variable, "").split()[:1] or usual)


NEEDED = {
    "Python 3.11 or later (name one by PYTHON=...)": sys.version_info >= (3, 11),
    "Python's venv (Debian: apt install python3-venv)": all(map(importlib.util.find_spec, ("ensurepip", "venv"))),
    "a C++ compiler (Debian: apt install g++)": has_compiler("CC", "cc", "gcc", "clang")
    and has_compiler("CXX", "c++", "g++", "clang++"),
    "Python's headers (Debian: apt install python3-dev)": os.path.exists(
        os.path.join(sysconfig.get_paths()["include"], "Python.h")
    ),
}

if __name__ == "__main__":
    lacking = "; ".join(name for name, there in NEEDED.items() if not there)
    if lacking:
        sys.exit(f"cannot install: missing {lacking}")
