"""What is missing to install the package is said in one line, before anything is downloaded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def said(folder: Path, programs: list[str], variables: dict[str, str] | None = None) -> tuple[int, str]:
    """Run the script where a PATH has only these programs; give its exit code and what it said."""
    for name in programs:
        (folder / name).write_text("#!/bin/sh\n")
        (folder / name).chmod(0o755)
    run = subprocess.run(
        [sys.executable, ROOT / "scripts" / "check_build_tools.py"],
        env={"PATH": str(folder), **(variables or {})},
        capture_output=True,
        text=True,
        check=False,
    )
    return run.returncode, run.stderr


@pytest.mark.parametrize("programs", [[], ["gcc", "cc"], ["g++", "c++"]], ids=["none", "only C", "only C++"])
def test_missing_compiler_is_one_line_that_names_gpp(tmp_path: Path, programs: list[str]) -> None:
    code, message = said(tmp_path, programs)
    assert code == 1
    assert message.count("\n") == 1
    assert "a C++ compiler (Debian: apt install g++)" in message


@pytest.mark.parametrize("programs", [["gcc", "g++"], ["clang", "clang++"], ["cc", "c++"]], ids=" ".join)
def test_compilers_of_both_languages_suffice(tmp_path: Path, programs: list[str]) -> None:
    assert "compiler" not in said(tmp_path, programs)[1]


def test_compiler_that_the_environment_names_must_exist(tmp_path: Path) -> None:
    programs = ["gcc", "g++", "own-c++"]
    assert "compiler" not in said(tmp_path, programs, {"CXX": "own-c++ -O2"})[1]
    assert "a C++ compiler" in said(tmp_path, programs, {"CXX": "missing-c++"})[1]
