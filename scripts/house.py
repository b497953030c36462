"""Print counts of the source: code by package, ways of solving, constants without a source, classes, tests.

What is named in the table of this file, such as the loops that solve, must exist. The rest is found in the source. The
source of a constant is a comment or docstring at it that names the script of scripts/ and the data that measured it, or
rows of scripts/measure/sensitivity.csv with its value, which tell what changes of it do. Numbers in a file of another
program's format have a source if its docstring names that program, after the words "Source of the numbers:".
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from measure.constants import constants_in, measured, read_table
from measure.places import ROOT
from measure.tables import Report, print_report

from dvrk_cmaes.errors import InputError

METHODS: Final = "track", "calibration", "segment", "pose", "evidence"
STATES: Final = "track", "calibration", "runs"
NAMED: Final = {
    "loops that solve": """
        pose/refine/gauss_newton.py:refine              pose/refine/direct.py:_coordinate_descent
        calibration/solve.py:solve                      calibration/solve.py:alternate""",
    "drivers of a fit": """
        calibration/frame_fit.py:fit_frame""",
    "predictions from readings": """
        calibration/prediction.py:Prediction""",
    "followers": """
        track/window.py:solve_window""",
}
"""What there is of each kind, as FILE:NAME in dvrk_cmaes."""
POSES: Final = re.compile(r"(camera|view|rig|base)_from_\w+|\w*_from_(root|base)|poses?|Posed")
FRAMES: Final = re.compile(r"\b(SessionFrame)\b")
SCRIPT: Final = re.compile(r"scripts/[\w/]+\.py")
FORMAT: Final = re.compile(r"Source of the numbers:\s.*\b\w+/\w+")
DRAWINGS: Final = ("segment/overlay.py",)
"""Files of method packages that draw: their numbers decide nothing, and are not counted."""
DATA: Final = re.compile(r"\.\./shared/|\bdata/|\bseeds? \d|\bsynth\b")
PRIVATE: Final = re.compile(r"(^|\.)_[a-zA-Z]\w*$")
CLOCKS: Final = re.compile(r"\b(perf_counter|process_time|thread_time|monotonic|time\.time)(_ns)?\(")
_NO_CODE: Final = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
    """A file of Python: its path relative to the folder that is counted, and its text."""

    path: Path
    text: str

    @cached_property
    def body(self) -> list[ast.stmt]:
        """The statements of the file."""
        return ast.parse(self.text).body

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of the parsed file."""
        return [node for statement in self.body for node in ast.walk(statement)]

    @property
    def package(self) -> str:
        """First folder of the path; that of a single file is its name."""
        return self.path.parts[0].removesuffix(".py")

    @property
    def code(self) -> int:
        """Number of lines of code."""
        lines: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(self.text).readline):
            if token.type not in _NO_CODE and token.string:
                lines.update(range(token.start[0], token.end[0] + 1))
        for node in self.nodes:
            if isinstance(node, ast.Import | ast.ImportFrom) or (isinstance(node, ast.Expr) and _is_text(node)):
                lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        return len(lines)

    def names(self) -> Iterator[str]:
        """Yield the names of functions and classes, and those of methods as CLASS.METHOD."""
        for node in self.body:
            if isinstance(node, ast.ClassDef | Function):
                yield node.name
            if isinstance(node, ast.ClassDef):
                yield from (f"{node.name}.{each.name}" for each in node.body if isinstance(each, Function))

    def constants(self, root: Path, known: Mapping[tuple[str, str], set[str]]) -> Iterator[bool]:
        """Yield for each number in assignments whether its source is stated, or its value is a measured one."""
        lines, of_format = self.text.splitlines(), bool(FORMAT.search(ast.get_docstring(ast.parse(self.text)) or ""))
        for node, after in zip(self.body, [*self.body[1:], None], strict=True):
            for constant in constants_in([node]):
                first, last = node.lineno - 1, node.end_lineno
                while first and lines[first - 1].startswith("#"):
                    first -= 1
                stated = "\n".join(lines[first : after.end_lineno if after and _is_text(after) else last])
                scripts = SCRIPT.findall(stated)
                sourced = bool(scripts and DATA.search(stated)) and all((root / each).is_file() for each in scripts)
                sourced |= of_format or constant.value in known.get((self.path.as_posix(), constant.name), ())
                yield from [sourced] * constant.numbers


def _is_text(node: ast.stmt) -> bool:
    """Whether a statement is a text that stands for itself, such as a docstring."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def attributes(of: ast.ClassDef) -> dict[str, str]:
    """Return the fields of a class, and what its methods assign to self, with their annotations, or ""."""
    fields = [each for each in of.body if isinstance(each, ast.AnnAssign)]
    found = {ast.unparse(each.target): ast.unparse(each.annotation) for each in fields}
    for node in ast.walk(of):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and ast.unparse(node.value) == "self":
            found.setdefault(node.attr, "")
    return found


def modules_in(folder: Path) -> list[Module]:
    """Read all Python files of a folder; InputError if there are none."""
    found = [Module(p.relative_to(folder), p.read_text(encoding="utf-8")) for p in sorted(folder.rglob("*.py"))]
    if not found:
        raise InputError(f"{folder}: expected Python files, got none")
    return found


def private_patches(module: Module) -> int:
    """Count the calls of ``setattr`` and ``patch`` whose name to replace begins with an underscore."""
    calls = [node for node in module.nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)]
    patched = [call.args[:2] for call in calls if getattr(call.func, "attr", "") in ("setattr", "patch")]
    return sum(any(PRIVATE.search(str(getattr(arg, "value", ""))) for arg in args) for args in patched)


def check_names(modules: Sequence[Module]) -> None:
    """Raise an InputError for a name of ``NAMED`` that the package does not have."""
    known = {f"{module.path.as_posix()}:{name}" for module in modules for name in module.names()}
    for kind, name in ((kind, name) for kind, names in NAMED.items() for name in names.split()):
        if name not in known:
            raise InputError(f"scripts/house.py: {kind}: expected a name of dvrk_cmaes, got {name}")


def counts(root: Path) -> Report:
    """Count what the source of a checkout has; InputError if a named function or class is not there."""
    package, tests = modules_in(root / "dvrk_cmaes"), modules_in(root / "tests")
    check_names(package)
    code = Counter({name: sum(m.code for m in package if m.package == name) for name in {m.package for m in package}})
    tried = measured(read_table(root / "scripts" / "measure" / "sensitivity.csv"))
    methods = [module for module in package if module.package in METHODS and module.path.as_posix() not in DRAWINGS]
    stated = [known for module in methods for known in module.constants(root, tried)]
    classes = [(module, node) for module in package for node in module.nodes if isinstance(node, ast.ClassDef)]
    held = [
        (len(attributes(each)), each.name) for m, each in classes if m.package in STATES and m.path.stem != "document"
    ]
    posed = [any(POSES.fullmatch(a) or "Posed" in kind for a, kind in attributes(each).items()) for _, each in classes]
    functions = [node for module in package for node in module.nodes if isinstance(node, Function)]
    lengths = [len(module.text.splitlines()) for module in package if module.path.name != "__init__.py"]
    figures = {
        "lines of code": sum(code.values()),
        f"lines of {', '.join(STATES)}": sum(code[name] for name in STATES),
        **{kind: len(names.split()) for kind, names in NAMED.items()},
        f"numbers in constants of {', '.join(METHODS)}": len(stated),
        "of these without source": stated.count(False),
        "classes with a pose": sum(posed),
        f"fields of {max(held)[1]}, the most of a state in {', '.join(STATES)}": max(held)[0],
        "functions that take a session's frames": sum(bool(FRAMES.search(ast.unparse(f.args))) for f in functions),
        "functions that return them": sum(bool(f.returns and FRAMES.search(ast.unparse(f.returns))) for f in functions),
        "names of several classes": sum(n > 1 for n in Counter(each.name for _, each in classes).values()),
        "modules over 400 lines": sum(length > 400 for length in lengths),
        "modules under 25 lines": sum(length < 25 for length in lengths),
        "tests: patches of private names": sum(private_patches(module) for module in tests),
        "tests: files that read clocks": sum(bool(CLOCKS.search(module.text)) for module in tests),
    }
    return {
        "figures": [{"count": count, "of": name} for name, count in figures.items()],
        "lines of code by package": [{"lines": lines, "package": name} for name, lines in code.most_common()],
    }


def main() -> int:
    """Print the counts of a checkout; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, default=ROOT, metavar="CHECKOUT", help="what is counted (default: this)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    return print_report("house.py", lambda: counts(options.root), as_json=options.json)


if __name__ == "__main__":
    sys.exit(main())
