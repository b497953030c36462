"""These tests, and the helpers that they use, know the program by its public names and its commands alone."""

from __future__ import annotations

import ast
from pathlib import Path

TESTS = Path(__file__).parents[1]
ALLOWED = {"dvrk_cmaes", "dvrk_cmaes.testing"}


def imported(path: Path) -> set[str]:
    """Give the modules that a file imports, also within functions, and those that it names in texts."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value  # as of mock.patch("dvrk_cmaes.x") or import_module
            found |= {text} if all(part.isidentifier() for part in text.split(".")) else set()
    return found


def test_no_internal_module_is_imported() -> None:
    files = sorted((TESTS / "promises").glob("*.py"))
    for path in files:  # and the helpers that are imported, which are appended
        own = {TESTS / f"{name.replace('.', '/')}.py" for name in imported(path) if name.startswith("helpers.")}
        files += sorted(own - set(files))
    internal = {
        f"{path.name}: {name}"
        for path in files
        for name in imported(path)
        if name.partition(".")[0] == "dvrk_cmaes" and name not in ALLOWED
    }
    assert not internal
    assert len(files) > 4
