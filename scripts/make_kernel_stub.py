"""Write dvrk_cmaes/_kernel.pyi, the types of the compiled module, or check with --check that it is up to date.

    python scripts/make_kernel_stub.py [--check]

Needs nanobind and ruff, which are among the tools of development.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STUB = ROOT / "dvrk_cmaes" / "_kernel.pyi"


def stub() -> str:
    """Return the types of the installed module, formatted."""
    from nanobind.stubgen import StubGen

    from dvrk_cmaes import _kernel

    generator = StubGen(_kernel, include_docstrings=False, quiet=True)
    generator.put(_kernel)
    types = re.sub(r"Annotated\[(NDArray\[[\w.]+\]), dict\([^)]*\)\]", r"\1", generator.get())
    types = types.replace("Callable | None", "Callable[..., NDArray[numpy.bool_]] | None")
    types = types.replace("from typing import Annotated\n", "")
    formatter = [str(Path(sys.executable).parent / "ruff"), "format", "--stdin-filename", str(STUB), "-"]
    return subprocess.run(formatter, input=types, capture_output=True, text=True, check=True, cwd=ROOT).stdout


def main(arguments: list[str]) -> int:
    """Write or check the file; the exit code is 1 if it is checked and differs."""
    text = stub()
    if arguments != ["--check"]:
        STUB.write_text(text, encoding="utf-8")
        return 0
    if STUB.is_file() and STUB.read_text(encoding="utf-8") == text:
        return 0
    print(f"{STUB}: expected what python scripts/make_kernel_stub.py writes, got other types")
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
