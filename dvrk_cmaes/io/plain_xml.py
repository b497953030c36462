"""XML from files of others, parsed without document types.

No robot, mesh or calibration needs one, and the entities declared in it can expand without end or name other files.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import NoReturn

from dvrk_cmaes.errors import InputError


class _NoDoctype(ElementTree.TreeBuilder):
    """A tree builder that stops at a document type declaration, before any entity in it is expanded."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        raise InputError("a document type (<!DOCTYPE ...>) is refused; expected plain XML without entities")


def parse_xml(path: Path, data: bytes) -> ElementTree.Element:
    """Parse the bytes of an XML file, comments left out.

    Raises
    ------
    InputError
        Naming the file: not well-formed, of an unknown encoding, or with a document type.
    """
    parser = ElementTree.XMLParser(target=_NoDoctype())
    try:
        parser.feed(data)
        root: ElementTree.Element = parser.close()
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: not well-formed XML: {' '.join(str(error).split())}") from None
    return root
