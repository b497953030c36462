"""Print counts of the source: code by package, files, classes, tests and scripts, of a checkout (--root).

Lines of code are those without comments, docstrings, imports and blank ones; lines of tests and scripts are all lines.
A test file uses public names if it imports of the package only `dvrk_cmaes` itself, and its `cli` and `errors`.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from measuring.report import ROOT, Report, print_report

from dvrk_cmaes.errors import InputError

PUBLIC: Final = re.compile(r"dvrk_cmaes(\.cli|\.errors)?")
PRIVATE: Final = re.compile(r"(^|\.)_[a-zA-Z]\w*$")
_NO_CODE: Final = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)


@dataclass(frozen=True)
class Module:
    """A file of Python: its path relative to the folder that is counted, and its text."""

    path: Path
    text: str

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of the parsed file."""
        return [*ast.walk(ast.parse(self.text))]

    @property
    def lines(self) -> int:
        """Number of all lines."""
        return len(self.text.splitlines())

    @cached_property
    def code(self) -> int:
        """Number of lines of code."""
        lines: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(self.text).readline):
            if token.type not in _NO_CODE and token.string:
                lines.update(range(token.start[0], token.end[0] + 1))
        for node in self.nodes:
            if isinstance(node, ast.Import | ast.ImportFrom) or (
                isinstance(node, ast.Expr)
                and isinstance(node.value, ast.Constant)
                and isinstance(node.value.value, str)
            ):
                lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        return len(lines)

    @property
    def imports_internals(self) -> bool:
        """Whether it imports modules of the package that are not public."""
        named = [node.module or "" for node in self.nodes if isinstance(node, ast.ImportFrom)]
        named += [each.name for node in self.nodes if isinstance(node, ast.Import) for each in node.names]
        return any(name.startswith("dvrk_cmaes") and not PUBLIC.fullmatch(name) for name in named)

    @property
    def private_patches(self) -> int:
        """Number of calls of ``setattr`` and ``patch`` whose name to replace begins with an underscore."""
        calls = (node for node in self.nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute))
        named = (call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr in _PATCHES)
        texts = (arg.value for call in named for arg in call.args if isinstance(arg, ast.Constant))
        return sum(isinstance(text, str) and bool(PRIVATE.search(text)) for text in texts)


_PATCHES: Final = ("setattr", "setitem", "delattr", "object", "patch")


def modules_in(folder: Path) -> list[Module]:
    """Read all Python files of a folder; InputError if there are none."""
    found = [Module(p.relative_to(folder), p.read_text(encoding="utf-8")) for p in sorted(folder.rglob("*.py"))]
    if not found:
        raise InputError(f"{folder}: expected Python files, got none")
    return found


def counts(root: Path) -> Report:
    """Count what the source of a checkout has."""
    package, tests, scripts = (modules_in(root / name) for name in ("dvrk_cmaes", "tests", "scripts"))
    code: Counter[str] = Counter()
    for module in package:
        code[module.path.parts[0].removesuffix(".py")] += module.code
    figures = {
        "lines of code of the package": code.total(),
        "files": len(package),
        "classes": sum(isinstance(node, ast.ClassDef) for module in package for node in module.nodes),
        "modules over 400 lines": sum(module.lines > 400 for module in package),
        "modules under 25 lines": sum(module.lines < 25 for module in package if module.path.name != "__init__.py"),
        "lines of tests": sum(module.lines for module in tests),
        "of these in files that import internals": sum(module.lines for module in tests if module.imports_internals),
        "tests: patches of private names": sum(module.private_patches for module in tests),
        "lines of scripts": sum(module.lines for module in scripts),
    }
    return {
        "figures": [{"count": count, "of": name} for name, count in figures.items()],
        "lines of code by package": [{"lines": lines, "package": name} for name, lines in code.most_common()],
    }


def main() -> int:
    """Print the counts of a checkout; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=ROOT, metavar="CHECKOUT", help="what is counted (default: this)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    return print_report("house.py", lambda: counts(options.root), as_json=options.json)


if __name__ == "__main__":
    sys.exit(main())
