"""What .github/SECURITY.md promises of the code: no loader of pickles, no other program, no network, no eval."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from helpers.places import ROOT

PACKAGE = ROOT / "dvrk_cmaes"

FORBIDDEN = frozenset(
    (
        *("pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"),
        *("subprocess", "pty", "commands", "multiprocessing", "ctypes", "runpy"),
        *("socket", "ssl", "http", "ftplib", "smtplib", "xmlrpc", "asyncio", "socketserver", "webbrowser"),
        *("requests", "httpx", "urllib3", "aiohttp", "distributed", "dask", "websocket", "websockets", "rclpy"),
        *("roslibpy", "twisted", "autobahn"),
    )
)
"""Modules that load code from data, start programs or open connections."""

ALLOWED = {
    "io/handles.py": {"ctypes"},  # renameat2(2), which exchanges two folders in one step
    "runs/live_session.py": {"ctypes"},  # mallopt(3), by which the memory of live stays as it is
    "runs/worker.py": {"pickle", "socket"},  # between the program's own processes; the host's name
    "runs/worker_process.py": {"multiprocessing"},  # the program's own processes
    "runs/cluster.py": {"socket", "distributed"},  # batch --scheduler
    "live/rosbridge.py": {"roslibpy", "twisted", "autobahn"},  # live
    "live/rclpy_node.py": {"rclpy"},  # live
}

CALLS = frozenset({"eval", "exec", "compile", "__import__", "system", "popen", "execv", "spawnv", "startfile"})


@cache
def tree_of(file: Path) -> ast.Module:
    """Parse a file."""
    return ast.parse(file.read_text(encoding="utf-8"))


def modules_in(file: Path) -> Iterator[str]:
    """Give the first part of the name of every module that a file imports, anywhere in it."""
    for statement in ast.walk(tree_of(file)):
        if isinstance(statement, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in statement.names)
        elif isinstance(statement, ast.ImportFrom) and not statement.level:
            module = statement.module or ""
            yield "http" if module.startswith(("urllib.request", "http")) else module.partition(".")[0]


FILES = [str(path.relative_to(PACKAGE)) for path in sorted(PACKAGE.rglob("*.py"))]


@pytest.mark.parametrize("name", FILES)
def test_only_named_files_import_dangerous_modules(name: str) -> None:
    assert {*modules_in(PACKAGE / name)} & FORBIDDEN <= ALLOWED.get(name, set())


@pytest.mark.parametrize("name", FILES)
def test_no_file_runs_text_as_code_or_starts_a_program(name: str) -> None:
    tree = tree_of(PACKAGE / name)
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        match call.func:
            case ast.Name(id=called):
                assert called not in CALLS, f"line {call.lineno}"
            case ast.Attribute(value=ast.Name(id="os"), attr=called):
                assert called not in CALLS, f"line {call.lineno}"
            case ast.Attribute(value=ast.Name(id="np"), attr="load"):
                allowed = [word.value for word in call.keywords if word.arg == "allow_pickle"]
                assert [value.value for value in allowed if isinstance(value, ast.Constant)] == [False]


def test_exceptions_are_named_in_the_document() -> None:
    text = (ROOT / ".github" / "SECURITY.md").read_text(encoding="utf-8")
    assert all(word in text for word in ("multiprocessing", "--scheduler", "`live`", "allow_pickle=False"))
