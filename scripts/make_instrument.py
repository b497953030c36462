"""Write the bundled, parametric instruments as URDFs with one mesh for each moving link.

    python scripts/make_instrument.py            # writes data/instruments/lnd and data/instruments/dvrk
    python scripts/make_instrument.py --check    # exit code 1 if those files differ from what this script writes

The same solids give the same bytes. The script needs manifold3d: pip install '.[make]'.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
from plyfile import PlyData, PlyElement

try:
    from dvrk_instruments import Tool, tools
    from dvrk_instruments import roll_link as dvrk_roll_link
    from manifold3d import Manifold
    from needle_driver import PITCH_TO_YAW, TIP_FRAME, jaw_1_link, roll_link, wrist_pitch_link
except ModuleNotFoundError as missing:
    print(f"make_instrument.py: {missing.name} is missing; pip install '.[make]'", file=sys.stderr)
    sys.exit(2)

OUT: Final = Path(__file__).resolve().parents[1] / "data" / "instruments"
SIMPLIFY: Final = 0.003  # mm, tolerance for collapsing short edges that the Boolean operations leave
SIMPLIFY_MORE: Final = 0.03  # mm, the same for the instruments of dvrk_instruments.py
HALF_TURN: Final = '<origin xyz="0 0 0" rpy="0 3.141592653589793 0"/>'  # about y: jaw_1's mesh as jaw_2


def ply_bytes(solid: Manifold) -> bytes:
    """Return a binary PLY in metres, with sorted vertices and faces, so that the same solid gives the same bytes."""
    mesh: Any = solid.to_mesh()
    points = (np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3] * 1e-3).astype("<f4") + np.float32(0)
    faces = np.asarray(mesh.tri_verts, dtype=np.int64)
    order = np.lexsort(points.T[::-1])
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    faces = rank[faces]
    faces = faces[np.arange(len(faces))[:, None], (faces.argmin(1)[:, None] + np.arange(3)) % 3]
    faces = faces[np.lexsort(faces.T[::-1])]
    vertex = np.array([tuple(p) for p in points[order]], dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    face = np.empty(len(faces), dtype=[("vertex_indices", "<u2", (3,))])
    face["vertex_indices"] = faces
    stream = io.BytesIO()
    PlyData([PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")], byte_order="<").write(stream)
    return stream.getvalue()


def link(name: str, mesh: str | None, origin: str = "") -> list[str]:
    """Return the lines of a link, with a mesh of the folder meshes/ or without one."""
    if mesh is None:
        return [f'  <link name="{name}"/>']
    geometry = f'{origin}<geometry><mesh filename="meshes/{mesh}.ply"/></geometry>'
    return [f'  <link name="{name}">', f"    <visual>{geometry}</visual>", "  </link>"]


def moving(
    name: str,
    parent: str,
    limits: tuple[float, float],
    *,
    place: str = "0 0 0",
    rpy: str = "0 0 0",
    mimic: str = "",
    kind: str = "revolute",
    axis: str = "0 0 1",
) -> list[str]:
    """Return the lines of a joint; ``mimic`` holds the attributes multiplier and offset of a joint that follows jaw."""
    return [
        f'  <joint name="{name}" type="{kind}">',
        f'    <parent link="{parent}"/><child link="{name}_link"/>',
        f'    <origin xyz="{place}" rpy="{rpy}"/>',
        f'    <axis xyz="{axis}"/><limit lower="{limits[0]:g}" upper="{limits[1]:g}" velocity="0.4" effort="1000"/>',
        *([f'    <mimic joint="jaw" {mimic}/>'] if mimic else []),
        "  </joint>",
    ]


def urdf(name: str, title: str, tool: Tool, meshes: dict[str, str]) -> bytes:
    """Return the URDF: names, axes and limits are those of the dVRK's own model; metres and radians."""
    turn = "-1.5707963267948966 -1.5707963267948966 0"
    pitch, yaw, free = tool.pitch_limit, tool.yaw_limit, 1.5707
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<!-- {title} from the roll link down. Made by scripts/make_instrument.py: change that, not this.",
        "     roll_link: +z along the shaft, distally; origin on the wrist pitch axis. Metres, radians. -->",
        f'<robot name="{name}">',
        *link("roll_link", meshes["roll_link"]),
        *moving("wrist_pitch", "roll_link", (-pitch, pitch), rpy=turn),
        *link("wrist_pitch_link", meshes["wrist_pitch_link"]),
        *moving("wrist_yaw", "wrist_pitch_link", (-yaw, yaw), place=f"{tool.pitch_to_yaw * 1e-3:g} 0 0", rpy=turn),
        *link("wrist_yaw_link", meshes.get("wrist_yaw_link")),
    ]
    hinge = "wrist_yaw_link"
    if tool.slide != (0, 0):  # the hinge of the jaws is shifted along the blades as they open
        offset, slope = (1e-3 * value for value in tool.slide)
        hinge, ends = "jaw_axis_link", sorted(offset + slope * end for end in tool.jaw_limits or ())
        follows = f'multiplier="{slope:g}" offset="{offset:g}"'
        lines += moving("jaw_axis", "wrist_yaw_link", (ends[0], ends[1]), mimic=follows, kind="prismatic", axis="0 1 0")
        lines += link("jaw_axis_link", None)
    if tool.jaw_limits is None:
        lines += [
            '  <joint name="jaw" type="fixed">',
            f'    <parent link="{hinge}"/><child link="jaw_link"/>',
            "  </joint>",
        ]
        lines += link("jaw_link", meshes["jaw_link"])
    else:
        lines += [*moving("jaw", hinge, tool.jaw_limits), *link("jaw_link", None)]
        for jaw, sign in (("jaw_1", tool.jaw_sign), ("jaw_2", -tool.jaw_sign)):
            lines += moving(jaw, hinge, (-free, free), mimic=f'multiplier="{0.5 * sign:g}"')
            own = meshes.get(f"{jaw}_link")
            lines += link(f"{jaw}_link", own or meshes["jaw_1_link"], "" if own else HALF_TURN)
    lines += [
        '  <joint name="tool_tip" type="fixed">',
        '    <parent link="wrist_yaw_link"/><child link="tool_tip_link"/>',
        f'    <origin xyz="0 {tool.tip * 1e-3:g} 0" rpy="0 1.5707963267948966 1.5707963267948966"/>',
        "  </joint>",
        *link("tool_tip_link", None),
        "</robot>",
    ]
    return ("\n".join(lines) + "\n").encode()


def instrument_files() -> dict[str, bytes]:
    """Make the files of all instruments: contents by path relative to data/instruments."""
    jaw, right = jaw_1_link(), 1.39626
    needle_driver = ("Large Needle Driver", PITCH_TO_YAW, TIP_FRAME, right, right, (-0.349066, right), 1, (0, 0))
    lnd = Tool(*needle_driver, wrist_pitch_link(), None, jaw)
    turned = np.array([[-1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]])  # half a turn about y
    own = {name: name for name in ("roll_link", "wrist_pitch_link", "jaw_1_link", "jaw_2_link")}
    solids = {
        "lnd/meshes/roll_link": roll_link(),
        "lnd/meshes/wrist_pitch_link": lnd.wrist,
        "lnd/meshes/jaw_1_link": jaw,
        "lnd/meshes/jaw_2_link": jaw.transform(turned),
        "dvrk/meshes/roll": dvrk_roll_link(),
    }
    files = {"lnd/lnd.urdf": urdf("lnd", lnd.title, lnd, own)}
    for name, tool in tools().items():
        meshes = {"roll_link": "roll"}
        jaws = {"jaw_link" if tool.jaw_limits is None else "jaw_1_link": tool.jaw, "jaw_2_link": tool.other_jaw}
        for part, solid in {"wrist_pitch_link": tool.wrist, "wrist_yaw_link": tool.yaw, **jaws}.items():
            if solid is None:
                continue
            same = [path for path, other in solids.items() if other is solid]
            path = same[0] if same else f"dvrk/meshes/{name}_{part.removesuffix('_link')}"
            solids[path] = solid
            meshes[part] = Path(path).name
        files[f"dvrk/{name}.urdf"] = urdf(name, tool.title, tool, meshes)
    tolerance = {path: SIMPLIFY if path.startswith("lnd/") else SIMPLIFY_MORE for path in solids}
    return files | {f"{path}.ply": ply_bytes(solid.simplify(tolerance[path])) for path, solid in solids.items()}


def differences(folder: Path, files: dict[str, bytes]) -> list[str]:
    """List the files in the folder that are missing, different, or not made by this script, one message each."""
    found = []
    for name, contents in files.items():
        path = folder / name
        if not path.is_file():
            found.append(f"{path}: missing")
        elif path.read_bytes() != contents:
            found.append(f"{path}: not what scripts/make_instrument.py makes")
    unknown = {p.relative_to(folder).as_posix() for p in folder.glob("*/meshes/*")} - files.keys()
    return found + [f"{folder / name}: not made by scripts/make_instrument.py" for name in sorted(unknown)]


def write(folder: Path, files: dict[str, bytes]) -> None:
    """Write each file under a temporary name in its folder, then rename it."""
    for name, contents in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(path.name + ".part")
        temporary.write_bytes(contents)
        os.replace(temporary, path)


def main() -> int:
    """Write the files or compare with the existing ones; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out",
        type=Path,
        default=OUT,
        metavar="DIR",
        help="folder to write or to check (default: data/instruments)",
    )
    parser.add_argument("--check", action="store_true", help="compare with the existing files and write nothing")
    arguments = parser.parse_args()
    files = instrument_files()
    if not arguments.check:
        write(arguments.out, files)
        return 0
    found = differences(arguments.out, files)
    for line in found:
        print(line, file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
