"""The page that shows the scripts of scripts/examples."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Final

_INTRODUCTION: Final = """\
# Examples in Python

Each of these is a script in `scripts/examples` of the repository, and needs public names alone.
"""


def example_page(folder: Path) -> str:
    """Return the page in Markdown: the first sentence of each script, and its text."""
    return "\n".join([_INTRODUCTION, *(_example(path) for path in sorted(folder.glob("*.py")))])


def _example(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    said = (ast.get_docstring(ast.parse(text)) or "").split("\n\n")[0]
    title = path.stem.replace("_", " ").capitalize()
    return f'## {title}\n\n{said}\n\n```python title="scripts/examples/{path.name}"\n{text}```\n'
