"""Parse XML files that have no document type and are not too large.

A document type is not needed in files of robots, meshes and cameras, and entities declared in it can expand without
limit or refer to other files.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import NoReturn

from dvrk_cmaes.errors import InputError

_DEEPEST = 100  # nested elements
_MOST_ELEMENTS = 50_000
_LONGEST = 100_000  # characters of an attribute


class _PlainTree(ElementTree.TreeBuilder):
    """A tree builder that refuses a document type, before entities are expanded, and a tree that is too large."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._elements = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        raise InputError("a document type (<!DOCTYPE ...>) is refused; expected plain XML without entities")

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        self._depth += 1
        self._elements += 1
        if self._depth > _DEEPEST or self._elements > _MOST_ELEMENTS:
            limit = f"{_DEEPEST} levels" if self._depth > _DEEPEST else f"{_MOST_ELEMENTS} elements"
            raise InputError(f"expected XML of a robot, mesh or camera, got more than {limit}")
        longest = max(map(len, attrs.values()), default=0)
        if longest > _LONGEST:
            raise InputError(f"<{tag[:60]}>: expected a short attribute, got one of {longest} characters")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)


def parse_xml(path: Path, data: bytes) -> ElementTree.Element:
    """Parse the content of an XML file; comments are omitted.

    Raises
    ------
    InputError
        The file is not well-formed, has an unknown encoding or a document type, or is nested too deeply or too large.
    """
    parser = ElementTree.XMLParser(target=_PlainTree())
    try:
        parser.feed(data)
        root: ElementTree.Element = parser.close()
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: not well-formed XML: {' '.join(str(error).split())}") from None
    return root
