"""The pages on Python: the public names of `dvrk_cmaes`, by mkdocstrings, and the scripts of scripts/examples."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from typing import Any, Final

import dvrk_cmaes

_NAMES: Final = """\
# Python

The names of `dvrk_cmaes`. They are imported from there, are stable as [described](data/reference/stability.md), and
take and return metres, radians and pixels. The [examples](examples.md) are a place to begin, the
[conventions](data/reference/conventions.md) say what frames and joints are. `__version__` is the package's version.
"""
_TITLES: Final = ("Functions", "Classes", "Settings", "Errors")
_EXAMPLES: Final = """\
# Examples in Python

Each of these is a script in `scripts/examples` of the repository, and needs public names alone.
"""


def api_page() -> str:
    """Return the page in Markdown: a section for each kind of name, with an entry for each name."""
    values = {name: getattr(dvrk_cmaes, name) for name in dvrk_cmaes.__all__ if name != "__version__"}
    sections = [
        "\n".join(
            [f"## {title}\n", *(f"::: dvrk_cmaes.{name}" for name, value in values.items() if _kind(value) == title)]
        )
        for title in _TITLES
    ]
    return "\n\n".join([_NAMES, *sections]) + "\n"


def _kind(value: Any) -> str:
    """Return the title of the section of a public name."""
    if inspect.isfunction(value):
        return "Functions"
    if issubclass(value, Exception):
        return "Errors"
    return "Settings" if value.__module__ == "dvrk_cmaes.config" else "Classes"


def example_page(folder: Path) -> str:
    """Return the page in Markdown: the first sentence of each script, and its text."""
    return "\n".join([_EXAMPLES, *(_example(path) for path in sorted(folder.glob("*.py")))])


def _example(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    said = (ast.get_docstring(ast.parse(text)) or "").split("\n\n")[0]
    title = path.stem.replace("_", " ").capitalize()
    return f'## {title}\n\n{said}\n\n```python title="scripts/examples/{path.name}"\n{text}```\n'
