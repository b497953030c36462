"""Imports between packages go to lower layers only, and no module imports itself through others."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest
from helpers.places import ROOT, SCRIPTS

PACKAGE = ROOT / "dvrk_cmaes"
LAYERS = (
    ("__main__", "scripts"),
    ("cli",),
    ("runs", "live"),
    ("report", "__init__"),
    ("track",),
    ("estimation", "inspection"),
    ("segment", "calibration", "testing"),
    ("recording", "evaluate", "draw", "synth", "pose"),
    ("export", "frames", "silhouette", "evidence"),
    ("results",),
    ("joints",),
    ("instrument", "camera"),
    ("io",),
    ("errors", "config", "geometry"),
    ("_kernel",),
)
"""The packages and modules of dvrk_cmaes and the folder scripts, from the top layer to the lowest."""

LAYER = {node: number for number, nodes in enumerate(LAYERS) for node in nodes}


class Import(NamedTuple):
    """An import of another node."""

    file: Path
    line: int
    module: str
    source: str
    target: str

    def __str__(self) -> str:
        place = f"{self.file.relative_to(ROOT)}:{self.line}"
        return f"{place}: {self.source} imports {self.target} ({self.module})"


def files_of_nodes() -> dict[Path, str]:
    """Map each Python file of dvrk_cmaes and scripts to its node: its package, root module or "scripts"."""
    sources = [*PACKAGE.rglob("*.py"), *PACKAGE.glob("*.pyi")]
    files = {path: path.relative_to(PACKAGE).parts[0].partition(".")[0] for path in sources}
    return files | dict.fromkeys(SCRIPTS.rglob("*.py"), "scripts")


@cache
def tree_of(file: Path) -> ast.Module:
    """Parse a file."""
    return ast.parse(file.read_text(encoding="utf-8"))


@cache
def is_module(*parts: str) -> bool:
    """Whether a dotted name is that of a module or package in this checkout."""
    path = ROOT.joinpath(*parts)
    return path.is_dir() or path.with_suffix(".py").is_file() or path.with_suffix(".pyi").is_file()


def imported_modules(statement: ast.AST, file: Path) -> Iterator[str]:
    """Give the absolute names of the modules that a statement imports; none for other statements."""
    if isinstance(statement, ast.Import):
        yield from (alias.name for alias in statement.names)
    elif isinstance(statement, ast.ImportFrom):
        package = file.relative_to(ROOT).parts[: -statement.level] if statement.level else ()
        parts = [*package, *(statement.module or "").split(".")]
        for alias in statement.names:
            name = [part for part in (*parts, alias.name) if part]
            yield ".".join(name if is_module(*name) else name[:-1])


def node_of(module: str) -> str | None:
    """Give the node of a module; None for a module of another project."""
    first, _, rest = module.partition(".")
    if first == PACKAGE.name:
        return rest.partition(".")[0] or "__init__"
    return "scripts" if first in script_names() else None


@cache
def script_names() -> frozenset[str]:
    files = [path.relative_to(SCRIPTS).with_suffix("") for path in SCRIPTS.rglob("*.py")]
    return frozenset({"scripts", *(part for path in files for part in path.parts)})


@pytest.fixture(scope="module")
def imports() -> list[Import]:
    """Give all imports of one node by another, including those inside functions and under TYPE_CHECKING."""
    found = []
    for file, source in sorted(files_of_nodes().items()):
        for statement in ast.walk(tree_of(file)):
            for module in imported_modules(statement, file):
                target = node_of(module)
                if target is not None and target != source:
                    found.append(Import(file, statement.lineno, module, source, target))  # type: ignore[attr-defined]
    return found


def test_every_package_has_a_layer() -> None:
    without = {str(path.relative_to(ROOT)) for path, node in files_of_nodes().items() if node not in LAYER}
    assert not without, f"not in LAYERS: {', '.join(sorted(without))}"
    assert set(LAYER) == set(files_of_nodes().values())


def test_every_import_goes_to_a_lower_layer(imports: list[Import]) -> None:
    wrong = [str(each) for each in imports if LAYER.get(each.source, -1) >= LAYER.get(each.target, -1)]
    assert not wrong, "\n".join(["these imports do not go to a lower layer:", *wrong])


def module_of(file: Path) -> str:
    """Give the name of a file's module; that of a package for its ``__init__``."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def at_import_time(nodes: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """Give the nodes that run when their module is imported: not in functions, nor for type checkers only."""
    for node in nodes:
        yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            yield from at_import_time(node.orelse)
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from at_import_time(ast.iter_child_nodes(node))


def imported_at_once(file: Path, tree: ast.Module) -> set[str]:
    """Give the modules of the package that a module with this content imports when it is imported itself."""
    named = {module for node in at_import_time([tree]) for module in imported_modules(node, file)}
    return {module for module in named if module.partition(".")[0] == PACKAGE.name} - {module_of(file)}


def cycle_of(graph: Mapping[str, set[str]]) -> list[str]:
    """Give the modules of a cycle of imports, each imported by the one before; empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1][::-1])
    return []


def test_no_module_imports_itself_through_others() -> None:
    graph = {module_of(file): imported_at_once(file, tree_of(file)) for file in PACKAGE.rglob("*.py")}
    assert "dvrk_cmaes.io.files" in graph["dvrk_cmaes.io.json_file"]
    cycle = cycle_of(graph)
    assert not cycle, f"a cycle of imports: {' -> '.join(cycle)}"


def test_commands_start_without_what_is_slow_to_import() -> None:
    """Each takes a second of processor time, in every worker process too."""
    run = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys, dvrk_cmaes.cli.app, dvrk_cmaes.runs.batch, dvrk_cmaes.runs.calibrate_folder, "
            "dvrk_cmaes.cli.golden, dvrk_cmaes.runs.track; "
            "print({'matplotlib', 'rerun', 'scipy.ndimage', 'scipy.stats', 'trimesh'} & {*sys.modules})",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout == "set()\n"
