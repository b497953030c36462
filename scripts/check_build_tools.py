"""Print in one line what is missing to install the package: Python's version, venv, a C compiler, Python's headers.

One dependency, scikit-fmm, has no wheels for Linux and is compiled. The script runs on any Python 3 without packages.
"""

import os
import shutil
import sys
import sysconfig

OLDEST = (3, 11)


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
    compiler = os.environ.get("CC") or (sysconfig.get_config_var("CC") or "cc").split()[0]
    if not any(shutil.which(name) for name in (compiler.split()[0], "cc", "gcc", "clang")):
        found.append("a C compiler (Debian: apt install gcc)")
    if not os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h")):
        found.append("Python's headers (Debian: apt install python3-dev)")
    return found


if __name__ == "__main__":
    lacking = missing()
    if lacking:
        sys.exit("cannot install: missing " + "; ".join(lacking))
