"""Size of the scene that a COLLADA (DAE) file describes, found before its nodes are instantiated.

A node may instantiate other nodes of the file, each of them any number of times, so that a short file can describe a
scene of exponential size, or one without end.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

from dvrk_cmaes.errors import InputError

_MOST_GEOMETRIES = 10_000


def check_dae_size(path: Path, root: Element) -> None:
    """Check the number of geometries in a DAE file's scene.

    Raises
    ------
    InputError
        It is above 10,000, or a node contains itself.
    """
    nodes = {node.get("id"): node for node in root.findall(".//{*}node") if node.get("id")}
    scenes = root.findall(".//{*}visual_scene")
    count = sum(_geometries(path, scene, nodes, {}, []) for scene in scenes)
    if count > _MOST_GEOMETRIES:
        raise InputError(f"{path}: expected a scene of at most {_MOST_GEOMETRIES} geometries, got more")


def _geometries(
    path: Path, element: Element, nodes: dict[str | None, Element], known: dict[str, int], inside: list[str]
) -> int:
    """Count the geometries that an element and the nodes instantiated in it have, at most one above the limit."""
    count = len(element.findall(".//{*}instance_geometry"))
    for instance in element.findall(".//{*}instance_node"):
        name = (instance.get("url") or "").removeprefix("#")
        if name in inside:
            raise InputError(f"{path}: node {name[:60]!r}: expected an end, got a node that contains itself")
        if name in nodes and name not in known:
            known[name] = 1 + _geometries(path, nodes[name], nodes, known, [*inside, name])
        count += known.get(name, 0)
    return min(count, _MOST_GEOMETRIES + 1)
