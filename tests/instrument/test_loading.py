"""Loading of URDFs and mesh files: search of mesh files, their contents, and the message for each unusable file."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.instrument_files import SCANNED, TETRA_OBJ, box_link, gripper, mesh_link, write_urdf
from plyfile import PlyData, PlyElement

from dvrk_cmaes import InputError, load_instrument
from dvrk_cmaes.instrument import Link
from dvrk_cmaes.instrument.meshes import read_mesh


def root(path: Path, **options: object) -> Link:
    """Load and give the first link."""
    return load_instrument(path, **options).links[0]  # type: ignore[arg-type]


def volume(link: Link) -> float:
    """Give the signed volume, positive for faces wound outwards."""
    a, b, c = np.moveaxis(link.vertices[link.faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def refused(path: Path, **options: object) -> str:
    """Load a file that must be refused; give the message, checked to be one line."""
    with pytest.raises(InputError) as caught:
        load_instrument(path, **options)  # type: ignore[arg-type]
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.fixture
def tetra(tmp_path: Path) -> Path:
    path = tmp_path / "tetra.obj"
    path.write_text(TETRA_OBJ)
    return path


# instruments


def test_unknown_name_is_refused() -> None:
    with pytest.raises(InputError, match=r"^lmd: no such URDF file, nor a bundled instrument \(bundled: lnd"):
        load_instrument("lmd")


@pytest.mark.shared
def test_scanned_polygons_are_triangulated() -> None:
    mesh = SCANNED.parent / "meshes" / "shaft_multi_cylinder.ply"
    corners = [len(face) for face in PlyData.read(str(mesh))["face"].data["vertex_indices"]]
    assert max(corners) > 3
    _, faces = read_mesh(mesh)
    fans = sum(corners) - 2 * len(corners)
    assert 0.9 * fans < len(faces) <= fans  # triangles without area are dropped


def test_missing_root_link_is_refused(tmp_path: Path) -> None:
    path = write_urdf(tmp_path, gripper())
    assert "no link 'rol_link' to take as the root; links present: roll_link, " in refused(path, root_link="rol_link")
    bare = write_urdf(tmp_path, box_link("tip"), "bare.urdf")
    assert refused(bare) == f"{bare}: no link 'roll_link' to take as the root; links present: tip"


def test_robot_without_geometry_is_refused(tmp_path: Path) -> None:
    assert "no visual geometry on link 'roll_link'" in refused(write_urdf(tmp_path, '<link name="roll_link"/>'))


# search of mesh files


@pytest.mark.parametrize(
    "name",
    [
        "package://x/../../etc/passwd",
        "package://x/a/../../b.obj",
        "package://../b.obj",
        "package://",
        "package://x\\..\\b.obj",
    ],
)
def test_path_outside_package_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "x" / "a").mkdir(parents=True)
    (tmp_path / "b.obj").write_text(TETRA_OBJ)
    message = refused(write_urdf(tmp_path / "x", mesh_link(name)))
    assert "climbs out of its package" in message or "expected package://NAME/path" in message


def test_missing_mesh_is_refused_with_tried_paths(tmp_path: Path) -> None:
    path = write_urdf(tmp_path, mesh_link("meshes/none.stl"))
    assert refused(path) == (
        f"{path}: link 'roll_link': mesh meshes/none.stl: no such file; tried {tmp_path / 'meshes' / 'none.stl'}"
    )
    path = write_urdf(tmp_path / "pack" / "urdf", mesh_link("package://pack/none.stl"))
    message = refused(path)
    assert str(tmp_path / "pack" / "none.stl") in message
    assert "--package-path NAME=DIR" in message


def test_unknown_scheme_is_refused(tmp_path: Path) -> None:
    assert "expected a path, file:// or package://" in refused(write_urdf(tmp_path, mesh_link("http://x/t.obj")))


# contents of meshes


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "dae", "stl_ascii"])
def test_mesh_formats_give_same_box(tmp_path: Path, kind: str) -> None:
    box = trimesh.creation.box(extents=[0.1, 0.2, 0.3])
    path = tmp_path / f"box.{kind.removesuffix('_ascii')}"
    box.export(path, file_type=kind)
    vertices, faces = read_mesh(path)
    assert (len(vertices), len(faces)) == (8, 12)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.1, 0.2, 0.3], rtol=1e-6)
    assert volume(Link("", vertices, faces)) == pytest.approx(0.006, rel=1e-5)


def test_collada_unit_is_converted_to_metres(tmp_path: Path) -> None:
    path = tmp_path / "box.dae"
    trimesh.creation.box(extents=[100, 200, 300]).export(path)
    head, end, tail = path.read_text().partition("</created>")
    path.write_text(f'{head}{end}<unit name="millimetre" meter="0.001"/>{tail}')
    np.testing.assert_allclose(np.ptp(read_mesh(path)[0], axis=0), [0.1, 0.2, 0.3], rtol=1e-6)


def write_ply(path: Path, vertices: list[tuple[float, float, float]], polygons: list[list[int]]) -> None:
    corners = np.array(vertices, dtype=[("x", "f4"), ("y", "f4"), ("z", "f4")])
    faces = np.empty(len(polygons), dtype=[("vertex_indices", "O")])
    faces["vertex_indices"] = [np.array(polygon, dtype="i4") for polygon in polygons]
    elements = [PlyElement.describe(corners, "vertex"), PlyElement.describe(faces, "face")]
    PlyData(elements, text=False).write(str(path))


def test_mixed_polygons_of_ply_are_triangulated(tmp_path: Path) -> None:
    ring = [(np.cos(a), np.sin(a), 0.0) for a in np.arange(5) * 2 * np.pi / 5]
    polygons = [[4, 3, 2, 1, 0], *([k, (k + 1) % 5, 5] for k in range(5))]
    write_ply(tmp_path / "pyramid.ply", [*ring, (0.0, 0.0, 1.0)], polygons)
    vertices, faces = read_mesh(tmp_path / "pyramid.ply")
    assert (len(vertices), len(faces)) == (6, 3 + 5)
    assert volume(Link("", vertices, faces)) == pytest.approx(5 * np.sin(2 * np.pi / 5) / 6, rel=1e-6)


def test_origin_and_scale_of_several_visuals(tmp_path: Path, tetra: Path) -> None:
    quarter = '<origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>'
    visuals = "".join(
        f'<visual>{origin}<geometry><mesh filename="tetra.obj" scale="{scale}"/></geometry></visual>'
        for origin, scale in ((quarter, "0.1 0.2 0.3"), ("", "0.5"))
    )
    link = root(write_urdf(tmp_path, f'<link name="roll_link">{visuals}</link>'))
    first = np.array([[1, 0, 0], [1, 0.1, 0], [0.8, 0, 0], [1, 0, 0.3]])
    second = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]])
    assert len(link.faces) == 8
    for corner in (*first, *second):
        assert np.linalg.norm(link.vertices - corner, axis=1).min() < 1e-12


@pytest.mark.parametrize(
    ("scale", "mirrored"), [("1 1 1", False), ("-1 1 1", True), ("-1 -1 1", False), ("-2 -1 -1", True)]
)
def test_faces_are_outward_for_negative_scales(tmp_path: Path, tetra: Path, scale: str, mirrored: bool) -> None:
    link = root(write_urdf(tmp_path, mesh_link("tetra.obj", f'scale="{scale}"')))
    assert volume(link) == pytest.approx(abs(np.prod(np.fromstring(scale, sep=" "))) / 6)
    assert (link.vertices[:, 0].min() < 0) == scale.startswith("-")
    assert mirrored == (np.prod(np.fromstring(scale, sep=" ")) < 0)


def test_collision_geometry_is_ignored(tmp_path: Path) -> None:
    for shape in ('<mesh filename="none.stl"/>', '<capsule radius="1"/>'):
        collision = f"<collision><geometry>{shape}</geometry></collision></link>"
        body = box_link("roll_link", "0.1 0.1 0.1").replace("</link>", collision)
        assert len(root(write_urdf(tmp_path, body)).faces) == 12


# refused meshes


def nan_stl() -> bytes:
    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, float("nan"), 0, 0)
    return bytes(80) + struct.pack("<I", 1) + triangle


PLY_HEAD = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
PLY_FACES = PLY_HEAD + b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("m.stl", b"version https://git-lfs.github.com/spec/v1\noid 0\n", "a Git LFS pointer, not"),
        ("m.ply", b"version https://git-lfs.github.com/spec/v1\noid 0\n", "a Git LFS pointer, not"),
        ("m.obj", b"# nothing\n", "m.obj: "),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "m.obj: "),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "m.obj: "),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "every face is degenerate"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "expected finite coordinates"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1e300 0\nf 1 2 3\n", "expected finite coordinates"),
        ("m.stl", nan_stl(), "expected finite coordinates"),
        ("m.stl", b"", "m.stl: "),
        ("m.stl", b"\x00\x01garbage" * 20, "m.stl: cut off or no STL: expected "),
        ("m.stl", bytes(80) + struct.pack("<I", 0), "m.stl: "),
        ("m.ply", b"ply\nformat ascii 1.0\nend_header\n", "m.ply: cannot be read as PLY: "),
        ("m.ply", PLY_HEAD + b"end_header\n0 0 0\n1 0 0\n0 1 0\n", "an empty mesh: 3 vertices, 0 faces"),
        ("m.ply", PLY_FACES + b"3 0 1 5\n", "faces refer to vertices that do not exist (there are 3)"),
        ("m.ply", PLY_FACES + b"2 0 1\n", "an empty mesh"),
        ("m.ply", PLY_FACES, "m.ply: cannot be read as PLY: "),
        ("m.dae", b"<COLLADA>", "m.dae: not well-formed XML"),
        ("m.dae", b'<!DOCTYPE x [<!ENTITY a "b">]><COLLADA/>', "a document type (<!DOCTYPE ...>) is refused"),
        ("m.dae", b"<COLLADA/>", "m.dae: cannot be read as DAE: "),
        ("m.step", b"?", "cannot read a mesh of kind '.step'; expected one of .stl, .obj, .dae, .ply"),
    ],
)  # fmt: skip
def test_unusable_mesh_file_is_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    refusal = refused(write_urdf(tmp_path, mesh_link(name)))
    assert message in refusal
    assert str(tmp_path / name) in refusal


def test_mesh_in_millimetres_is_refused_with_hint(tmp_path: Path, tetra: Path) -> None:
    message = refused(write_urdf(tmp_path, mesh_link("tetra.obj", 'scale="300 300 300"')))
    assert message.startswith(f"{tetra}: 300 m across; expected at most 5 m")
    assert 'scale="0.001 0.001 0.001"' in message


@pytest.mark.parametrize("scale", ["0 1 1", "1 1", "nan 1 1"])
def test_invalid_scale_is_refused(tmp_path: Path, tetra: Path, scale: str) -> None:
    assert "scale: expected three finite numbers" in refused(
        write_urdf(tmp_path, mesh_link("tetra.obj", f'scale="{scale}"'))
    )


@pytest.mark.parametrize(
    "shape",
    ['<box size="1 -1 1"/>', '<sphere radius="nan"/>', '<cylinder radius="9" length="1"/>', '<box size="1 1"/>'],
)
def test_invalid_primitive_is_refused(tmp_path: Path, shape: str) -> None:
    message = refused(
        write_urdf(tmp_path, f'<link name="roll_link"><visual><geometry>{shape}</geometry></visual></link>')
    )
    assert "link 'roll_link': " in message
    assert "expected" in message


# refused URDFs


def test_urdf_above_20_mb_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "big.urdf"
    with path.open("wb") as file:
        file.truncate(21_000_000)
    assert "21 MB; expected a URDF of at most 20 MB" in refused(path)


def test_number_is_that_of_one_urdf_in_the_packages(tmp_path: Path) -> None:
    paths = [write_urdf(tmp_path / "urdf", gripper(), f"instrument_{number}.urdf") for number in (400093, 400194)]
    packages = {"dvrk_model": tmp_path}
    joints = load_instrument("400093", package_paths=packages).joint_names
    assert joints == load_instrument(paths[0]).joint_names
    with pytest.raises(InputError, match=r"^400999: expected one URDF of this number in .*, got 0: instrument_"):
        load_instrument("400999", package_paths=packages)
    with pytest.raises(InputError, match=r"got 2: instrument_400093\.urdf, instrument_400194\.urdf"):
        load_instrument("400", package_paths=packages)
