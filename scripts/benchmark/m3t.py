"""Adapter of M3T (github.com/DLR-RM/3DObjectTracking): writes its model and configuration files, and reads poses.

M3T takes images without a lens, so these are undistorted. Its joints turn about an axis of a joint frame; the jaws,
which one joint moves, are two of them. Its generator reads ``config.yaml``. M3T writes no poses: a publisher is to
be added to it that prints ``body2world_pose()`` of each body after each image, as a row of ``poses.csv``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.optimize import least_squares
from worlds.motion import instrument_of

from benchmark.submission import JOINTS, Row
from benchmark.tasks import Given
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.geometry import frame_along, inverse, transform
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.atomic import write_image, write_text
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows
from dvrk_cmaes.io.short_text import shown

Float64 = NDArray[np.float64]

POSE_COLUMNS: Final = ("frame", "body", *(f"m{row}{column}" for row in range(3) for column in range(4)))
"""Columns of poses.csv: the first three rows of body2world_pose, m, whose world is the camera."""
_MODEL: Final = {"model_path": "INFER_FROM_NAME", "sphere_radius": 0.15, "n_divides": 4, "n_points": 200}
_FREE: Final = {"root": [1] * 6, "joint": [0, 0, 1, 0, 0, 0]}  # rx ry rz tx ty tz


def write_tracker(out: Path, given: Given, start: Row) -> Path:
    """Write M3T's files for a recording, about the pose of its first frame; return the path of config.yaml.

    Raises
    ------
    InputError
        The start has no pose, or an image cannot be read.
    """
    if start.pose is None or start.joints is None:
        raise InputError(f"world {start.world}, frame {start.frame}: expected a pose to start from, got none")
    instrument, camera = instrument_of(given.world.instrument), given.world.camera
    for name in given.frames:
        image = read_image(given.given.path / "images" / f"{name}.jpg")
        write_image(out / "images" / f"{name}.png", undistorted(camera, image))
    _write_yaml(out / "camera.yaml", _camera(camera, given.frames[0]))
    _write_yaml(out / "region_model.yaml", _MODEL)
    _write_yaml(out / "detector.yaml", {"link2world_pose": start.pose})
    poses = instrument.forward(start.joints)
    parents = _parents(instrument)
    for number, link in enumerate(instrument.links):
        mesh = trimesh.Trimesh(link.vertices, link.faces, process=False)
        write_text(out / f"{link.name}.obj", str(mesh.export(file_type="obj")))
        _write_yaml(out / f"{link.name}.yaml", _body(link.name, number + 1))
        parent = parents[link.name]
        from_parent = np.eye(4) if parent is None else inverse(poses[parent]) @ poses[number]
        axis = [0.0, 0, 1] if parent is None else instrument.chain.joints[instrument.link_joints[number]].axis
        turned = transform(frame_along(np.array(axis)), np.zeros(3))
        joint = {"joint2parent_pose": from_parent @ turned, "body2joint_pose": inverse(turned)}
        free = _FREE["root" if parent is None else "joint"]
        _write_yaml(out / f"{link.name}_link.yaml", ({} if parent is None else joint) | {"free_directions": free})
    write_text(out / "config.yaml", _config([link.name for link in instrument.links], parents, instrument))
    return out / "config.yaml"


def undistorted(camera: Camera, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image as a pinhole camera of the same matrix sees it."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    source = camera.project(rays.reshape(-1, 3)).reshape(*u.shape, 2).astype(np.float32)
    return np.asarray(cv2.remap(image, source[..., 0], source[..., 1], cv2.INTER_LINEAR), np.uint8)


def _camera(camera: Camera, first: str) -> dict[str, Any]:
    """Return the fields of M3T's camera."""
    names = {"f_u": camera.fx, "f_v": camera.fy, "pp_x": camera.cx, "pp_y": camera.cy}
    intrinsics = {**names, "width": camera.width, "height": camera.height}
    load = {"image_name_pre": "", "load_index": int(first), "n_leading_zeros": len(first), "image_name_post": ""}
    return {"load_directory": "images", "intrinsics": intrinsics, **load, "load_image_type": "png"}


def _body(name: str, number: int) -> dict[str, Any]:
    """Return the fields of M3T's body."""
    return {
        "geometry_path": f"{name}.obj",
        "geometry_unit_in_meter": 1.0,
        "geometry_counterclockwise": 1,
        "geometry_enable_culling": 0,
        "geometry2body_pose": np.eye(4),
        "body_id": number,
        "region_id": 1,
    }


def _parents(instrument: Instrument) -> dict[str, int | None]:
    """Return for each link the place of the link with a surface that carries it; None for the root."""
    places = {joint: number for number, joint in enumerate(instrument.link_joints)}
    parents: dict[str, int | None] = {}
    for link, joint in zip(instrument.links, instrument.link_joints, strict=True):
        above = joint if joint < 0 else instrument.chain.joints[joint].parent
        while above not in places:
            above = instrument.chain.joints[above].parent
        parents[link.name] = None if joint < 0 else places[above]
    return parents


def _config(names: list[str], parents: Mapping[str, int | None], instrument: Instrument) -> str:
    """Return config.yaml: bodies that share one region and its histograms, links, an optimizer and a tracker."""
    listed = ", ".join(names)
    lines = ["%YAML:1.2", "LoaderColorCamera:", "  - {name: color_camera, metafile_path: camera.yaml}", "Body:"]
    lines += [f"  - {{name: {name}, metafile_path: {name}.yaml}}" for name in names]
    lines += ["RendererGeometry:", f"  - {{name: geometry, bodies: [{listed}]}}", "FocusedSilhouetteRenderer:"]
    lines += [
        "  - {name: silhouettes, renderer_geometry: geometry, camera: color_camera, referenced_bodies: ["
        + listed
        + "]}",
        "RegionModel:",
    ]
    for name in names:
        others = ", ".join(other for other in names if other != name)
        model = f"name: {name}_model, metafile_path: region_model.yaml, body: {name}"
        lines.append(f"  - {{{model}, movable_same_region_bodies: [{others}]}}")
    lines.append("RegionModality:")
    for name in names:
        modality = f"name: {name}_modality, body: {name}, color_camera: color_camera, region_model: {name}_model"
        lines.append(f"  - {{{modality}, use_region_checking: {{focused_silhouette_renderer: silhouettes}}}}")
    lines.append("Link:")
    for number, name in reversed([*enumerate(names)]):  # children first
        children = [f"{child}_link" for child, parent in parents.items() if parent == number]
        link = f"name: {name}_link, metafile_path: {name}_link.yaml, body: {name}, modalities: [{name}_modality]"
        lines.append(f"  - {{{link}, child_links: [{', '.join(children)}]}}" if children else f"  - {{{link}}}")
    root = f"{instrument.root_link}_link"
    lines += ["Optimizer:", f"  - {{name: optimizer, root_link: {root}}}", "StaticDetector:"]
    lines += ["  - {name: detector, metafile_path: detector.yaml, optimizer: optimizer}", "Tracker:"]
    lines += ["  - {name: tracker, optimizers: [optimizer], detectors: [detector]}"]
    return "\n".join(lines) + "\n"


def _write_yaml(path: Path, fields: Mapping[str, Any]) -> None:
    """Write fields as OpenCV's YAML, which M3T reads."""
    storage = cv2.FileStorage("memory.yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in fields.items():
        _write_field(storage, name, value)
    write_text(path, storage.releaseAndGetString())


def _write_field(storage: cv2.FileStorage, name: str, value: Any) -> None:
    """Write a field: a matrix, numbers, named fields or a value."""
    if isinstance(value, list | dict):
        storage.startWriteStruct(name, cv2.FILE_NODE_SEQ if isinstance(value, list) else cv2.FILE_NODE_MAP)
        for key, inner in value.items() if isinstance(value, dict) else (("", inner) for inner in value):
            storage.write(key, inner)
        storage.endWriteStruct()
    else:
        storage.write(name, value)


def read_poses(path: Path, given: Given) -> list[Row]:
    """Read poses.csv: the poses of the bodies in each frame, whose joints are those that fit the poses best.

    Raises
    ------
    InputError
        Naming the file, the line and the column, what was expected and what was there.
    """
    instrument = instrument_of(given.world.instrument)
    names = [link.name for link in instrument.links]
    header, lines = read_csv_rows(path, expected="poses of M3T's bodies (poses.csv)")
    if header != list(POSE_COLUMNS):
        raise InputError(f"{path}: header: expected {','.join(POSE_COLUMNS)}, got {shown(','.join(header))}")
    frames: dict[str, dict[str, Float64]] = {}
    for where, cells in lines:
        for name, known in (("frame", given.frames), ("body", names)):
            if cells[name] not in known:
                raise InputError(
                    f"{where}: {name}: expected one of {known[0]} to {known[-1]}, got {shown(cells[name])}"
                )
        values = [number_in(where, name, cells) for name in POSE_COLUMNS[2:]]
        frames.setdefault(cells["frame"], {})[cells["body"]] = np.vstack([np.reshape(values, (3, 4)), [0, 0, 0, 1]])
    rows = []
    for frame, poses in frames.items():
        missing = [name for name in names if name not in poses]
        if missing:
            raise InputError(f"{path}: frame {frame}: expected a row of the body {missing[0]}, got none")
        root = poses[instrument.root_link]
        found = np.stack([inverse(root) @ poses[name] for name in names])
        middle = instrument.limits.mean(axis=1)

        def misfit(joints: Float64, found: Float64 = found) -> Float64:
            return np.asarray((instrument.forward(joints) - found)[:, :3, :3].ravel())

        joints = least_squares(misfit, middle).x
        rows.append(Row("images", given.world.number, frame, "ok", root, np.asarray(joints)))
    assert tuple(instrument.joint_names) == JOINTS
    return rows
