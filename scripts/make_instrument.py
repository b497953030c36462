"""Write the bundled instrument `lnd`, a parametric Large Needle Driver, as a URDF and one mesh for each moving link.

    python scripts/make_instrument.py            # writes data/instruments/lnd
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
    from manifold3d import Manifold
    from needle_driver import PITCH_TO_YAW, TIP_FRAME, jaw_1_link, roll_link, wrist_pitch_link
except ModuleNotFoundError as missing:
    print(f"make_instrument.py: {missing.name} is missing; pip install '.[make]'", file=sys.stderr)
    sys.exit(2)

OUT: Final = Path(__file__).resolve().parents[1] / "data" / "instruments" / "lnd"
SIMPLIFY: Final = 0.003  # mm, tolerance for collapsing short edges that the Boolean operations leave


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
    face = np.empty(len(faces), dtype=[("vertex_indices", "<i4", (3,))])
    face["vertex_indices"] = faces
    stream = io.BytesIO()
    PlyData([PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")], byte_order="<").write(stream)
    return stream.getvalue()


def urdf() -> str:
    """Return the URDF: names, axes and limits are those of the dVRK's own model; metres and radians."""
    turn = "-1.5707963267948966 -1.5707963267948966 0"
    wrist = (-1.39626, 1.39626)

    def link(name: str, *, mesh: bool) -> list[str]:
        if not mesh:
            return [f'  <link name="{name}"/>']
        geometry = f'<geometry><mesh filename="meshes/{name}.ply"/></geometry>'
        return [f'  <link name="{name}">', f"    <visual>{geometry}</visual>", "  </link>"]

    def revolute(
        name: str, parent: str, limits: tuple[float, float], *, x: float = 0.0, rpy: str = "0 0 0", mimic: float = 0.0
    ) -> list[str]:
        return [
            f'  <joint name="{name}" type="revolute">',
            f'    <parent link="{parent}"/><child link="{name}_link"/>',
            f'    <origin xyz="{x * 1e-3:g} 0 0" rpy="{rpy}"/>',
            f'    <axis xyz="0 0 1"/><limit lower="{limits[0]:g}" upper="{limits[1]:g}" velocity="0.4" effort="1000"/>',
            *([f'    <mimic joint="jaw" multiplier="{mimic:g}"/>'] if mimic else []),
            "  </joint>",
        ]

    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        "<!-- Large Needle Driver from the roll link down. Made by scripts/make_instrument.py: change that, not this.",
        "     roll_link: +z along the shaft, distally; origin on the wrist pitch axis. Metres, radians. -->",
        '<robot name="lnd">',
        *link("roll_link", mesh=True),
        *revolute("wrist_pitch", "roll_link", wrist, rpy=turn),
        *link("wrist_pitch_link", mesh=True),
        *revolute("wrist_yaw", "wrist_pitch_link", wrist, x=PITCH_TO_YAW, rpy=turn),
        *link("wrist_yaw_link", mesh=False),
        *revolute("jaw", "wrist_yaw_link", (-0.349066, 1.39626)),
        *link("jaw_link", mesh=False),
        *revolute("jaw_1", "wrist_yaw_link", (-1.5707, 1.5707), mimic=0.5),
        *link("jaw_1_link", mesh=True),
        *revolute("jaw_2", "wrist_yaw_link", (-1.5707, 1.5707), mimic=-0.5),
        *link("jaw_2_link", mesh=True),
        '  <joint name="tool_tip" type="fixed">',
        '    <parent link="wrist_yaw_link"/><child link="tool_tip_link"/>',
        f'    <origin xyz="0 {TIP_FRAME * 1e-3:g} 0" rpy="0 1.5707963267948966 1.5707963267948966"/>',
        "  </joint>",
        *link("tool_tip_link", mesh=False),
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def instrument_files() -> dict[str, bytes]:
    """Make the files of the instrument: contents by path relative to its folder."""
    jaw = jaw_1_link()
    solids = {
        "roll_link": roll_link(),
        "wrist_pitch_link": wrist_pitch_link(),
        "jaw_1_link": jaw,
        "jaw_2_link": jaw.transform(np.array([[-1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]])),  # half a turn about y
    }
    files = {f"meshes/{name}.ply": ply_bytes(solid.simplify(SIMPLIFY)) for name, solid in solids.items()}
    return {"lnd.urdf": urdf().encode(), **files}


def differences(folder: Path, files: dict[str, bytes]) -> list[str]:
    """List the files in the folder that are missing, different, or not made by this script, one message each."""
    found = []
    for name, contents in files.items():
        path = folder / name
        if not path.is_file():
            found.append(f"{path}: missing")
        elif path.read_bytes() != contents:
            found.append(f"{path}: not what scripts/make_instrument.py makes")
    unknown = {p.relative_to(folder).as_posix() for p in folder.glob("meshes/*")} - files.keys()
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
        help="folder to write or to check (default: data/instruments/lnd)",
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
