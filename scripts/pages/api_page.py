"""The page of the public names of `dvrk_cmaes`, whose text mkdocstrings takes from the docstrings."""

from __future__ import annotations

import inspect
from typing import Any, Final

import dvrk_cmaes

_INTRODUCTION: Final = """\
# Python

The names of `dvrk_cmaes`. They are imported from there, are stable as [described](data/reference/stability.md), and
take and return metres, radians and pixels. The [examples](examples.md) are a place to begin, the
[conventions](data/reference/conventions.md) say what frames and joints are. `__version__` is the package's version.
"""
_TITLES: Final = ("Functions", "Classes", "Settings", "Errors")


def api_page() -> str:
    """Return the page in Markdown: a section for each kind of name, with an entry for each name."""
    values = {name: getattr(dvrk_cmaes, name) for name in dvrk_cmaes.__all__ if name != "__version__"}
    sections = [
        "\n".join(
            [f"## {title}\n", *(f"::: dvrk_cmaes.{name}" for name, value in values.items() if _kind(value) == title)]
        )
        for title in _TITLES
    ]
    return "\n\n".join([_INTRODUCTION, *sections]) + "\n"


def _kind(value: Any) -> str:
    """Return the title of the section of a public name."""
    if inspect.isfunction(value):
        return "Functions"
    if issubclass(value, Exception):
        return "Errors"
    return "Settings" if value.__module__ == "dvrk_cmaes.config" else "Classes"
