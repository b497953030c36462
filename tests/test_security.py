"""What .github/SECURITY.md promises of the code: no loader of pickles, no other program, no network, no eval."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache

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
    "io/output.py": {"ctypes"},  # renameat2(2), which exchanges two folders in one step
    "runs/live_session.py": {"ctypes"},  # mallopt(3), by which the memory of live stays as it is
    "runs/worker.py": {"pickle", "socket"},  # between the program's own processes; the host's name
    "runs/pool.py": {"multiprocessing", "pickle"},  # the program's own processes
    "runs/cluster.py": {"socket", "distributed"},  # batch --scheduler
    "live/rosbridge.py": {"roslibpy", "twisted", "autobahn"},  # live
    "live/rclpy_node.py": {"rclpy"},  # live
}

CALLS = frozenset({"eval", "exec", "compile", "__import__", "system", "popen", "execv", "spawnv", "startfile"})


@cache
def found_in_package() -> dict[str, list[ast.Import | ast.ImportFrom | ast.Call]]:
    """Give the imports and calls in each file of the package, anywhere in it."""
    kinds = (ast.Import, ast.ImportFrom, ast.Call)
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
    return {
        str(path.relative_to(PACKAGE)): [node for node in ast.walk(tree) if isinstance(node, kinds)]
        for path, tree in trees.items()
    }


def modules_of(node: ast.AST) -> Iterator[str]:
    """Give the first part of the name of every module that an import names."""
    if isinstance(node, ast.Import):
        yield from (alias.name.partition(".")[0] for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and not node.level:
        module = node.module or ""
        yield "http" if module.startswith(("urllib.request", "http")) else module.partition(".")[0]


def test_only_named_files_import_dangerous_modules() -> None:
    imported = {
        name: {module for node in nodes for module in modules_of(node)} for name, nodes in found_in_package().items()
    }
    assert len(imported) > 300
    wrong = {name: modules & FORBIDDEN - ALLOWED.get(name, set()) for name, modules in imported.items()}
    assert {name: modules for name, modules in wrong.items() if modules} == {}


def is_dangerous(call: ast.Call) -> bool:
    """Whether a call runs text as code or starts a program, or may load pickles."""
    match call.func:
        case ast.Name(id=called) | ast.Attribute(value=ast.Name(id="os"), attr=called):
            return called in CALLS
        case ast.Attribute(value=ast.Name(id="np"), attr="load"):
            allowed = [word.value for word in call.keywords if word.arg == "allow_pickle"]
            return [value.value for value in allowed if isinstance(value, ast.Constant)] != [False]
    return False


def test_no_file_runs_text_as_code_or_starts_a_program() -> None:
    calls = [(name, node) for name, nodes in found_in_package().items() for node in nodes if isinstance(node, ast.Call)]
    assert len(calls) > 10_000
    assert [f"{name}: line {call.lineno}" for name, call in calls if is_dangerous(call)] == []


@pytest.mark.parametrize("text", ["eval(x)", "os.system(x)", "np.load(x)", "np.load(x, allow_pickle=True)"])
def test_dangerous_calls_are_found(text: str) -> None:
    (call,) = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call))
    assert is_dangerous(call)


def test_exceptions_are_named_in_the_document() -> None:
    text = (ROOT / ".github" / "SECURITY.md").read_text(encoding="utf-8")
    assert all(word in text for word in ("multiprocessing", "--scheduler", "`live`", "allow_pickle=False"))
