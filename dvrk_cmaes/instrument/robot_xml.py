"""A URDF file to yourdfpy's robot model, refusing what is not plain, finished URDF.

yourdfpy recovers silently from broken XML, which would lose links without a word; so the XML is checked here
first. Document type declarations are refused: a robot needs none, and entities in them can expand without end.
"""

from __future__ import annotations

import io
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any, NoReturn

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.meshes import one_line

#: Largest URDF that is read, bytes. Real ones have some ten thousand.
LARGEST_URDF = 20_000_000

_XACRO = "{http://www.ros.org/wiki/xacro}"
_UNUSED = ("collision", "inertial", "transmission", "gazebo", "material")


class _NoDoctype(ElementTree.TreeBuilder):
    """A tree builder that stops at a document type declaration, before any entity in it is expanded."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        raise InputError("a document type declaration (<!DOCTYPE ...>) is not accepted: expected plain XML")


def parse_xml(path: Path, data: bytes) -> ElementTree.Element:
    """Parse XML that has no document type. Raises `InputError`, naming the file."""
    parser = ElementTree.XMLParser(target=_NoDoctype())
    try:
        parser.feed(data)
        root: ElementTree.Element = parser.close()
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: not well-formed XML: {one_line(error)}") from None
    return root


def read_robot(path: Path) -> Any:
    """Read a URDF into yourdfpy's ``Robot`` (links with visuals, joints). No mesh file is touched.

    Raises
    ------
    InputError : unreadable, over 20 MB, not XML, with a document type, unexpanded xacro, or not a URDF.
    """
    try:
        size = path.stat().st_size
        data = path.read_bytes() if size <= LARGEST_URDF else b""
    except OSError as error:
        raise InputError(f"{path}: cannot read the URDF: {one_line(error)}") from None
    if size > LARGEST_URDF:
        raise InputError(f"{path}: {size / 1e6:.0f} MB; expected a URDF of at most {LARGEST_URDF // 10**6} MB")
    root = parse_xml(path, data)
    if root.tag != "robot":
        raise InputError(f"{path}: expected a URDF, whose root element is <robot>, got <{root.tag}>")
    if any(str(element.tag).startswith(_XACRO) for element in root.iter()):
        raise InputError(f"{path}: holds xacro macros; expected a URDF (run: xacro FILE > FILE.urdf)")
    for parent in list(root.iter()):
        for child in [child for child in parent if child.tag in _UNUSED]:
            parent.remove(child)

    import yourdfpy

    try:
        plain = io.BytesIO(ElementTree.tostring(root))
        model = yourdfpy.URDF.load(plain, build_scene_graph=False, load_meshes=False)
    except Exception as error:  # yourdfpy raises KeyError, AttributeError, ValueError, ... for a wrong element
        raise InputError(f"{path}: not a valid URDF: {type(error).__name__}: {one_line(error)}") from None
    return model.robot
