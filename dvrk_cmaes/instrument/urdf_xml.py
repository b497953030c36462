"""Reading of a URDF file into yourdfpy's robot model, with checks for malformed XML and unexpanded xacro.

yourdfpy recovers from malformed XML without an error and may then lose links. The XML is therefore parsed here first,
unused elements are removed, and the rest is passed to yourdfpy.
"""

from __future__ import annotations

import io
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.io.plain_xml import parse_xml

#: Size of the largest URDF that is read, bytes; typical files have ten thousand.
LARGEST_URDF = 20_000_000

_XACRO = "{http://www.ros.org/wiki/xacro}"
_UNUSED = ("collision", "inertial", "transmission", "gazebo", "material")


def read_robot(path: Path) -> Any:
    """Read a URDF into yourdfpy's ``Robot`` (links with visuals, joints) without reading the mesh files.

    Raises
    ------
    InputError
        The file cannot be read, is over 20 MB, not XML, has a document type or xacro macros, or is not a URDF.
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
    except Exception as error:  # yourdfpy raises KeyError, AttributeError, ValueError and others
        raise InputError(f"{path}: not a valid URDF: {_reason(error)}") from None
    return model.robot


def _reason(error: Exception) -> str:
    """Describe an error of yourdfpy, which does not check that required attributes and elements exist."""
    if isinstance(error, KeyError):
        return f"an element lacks the attribute {error}"
    if isinstance(error, (AttributeError, TypeError, IndexError)):
        return f"a required element or number is missing ({one_line(error)})"
    return one_line(error)
