"""``dvrk-cmaes inspect``: what the program makes of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dvrk_cmaes.cli.options import DEFAULT_CAMERA, INSTRUMENT, OUTPUT, CameraOptions, Flag, split_packages
from dvrk_cmaes.cli.terminal import Line, complain, show
from dvrk_cmaes.errors import InputError


def inspect(
    files: Annotated[tuple[Path, ...], Parameter(negative=())],
    /,
    *,
    camera: CameraOptions = DEFAULT_CAMERA,
    package_path: Annotated[tuple[str, ...], Parameter(group=INSTRUMENT, negative=(), show_default=False)] = (),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Say what files are taken for, what is read from them, and by which rule what is ambiguous is decided.

    Cameras, joint readings, masks, images, jaw tips, URDFs, meshes, the dVRK's tools, kinematics and registrations,
    results, and folders: sessions and results. Recordings are named only. Exit code 2 if one could not be read.

    Example:

    `dvrk-cmaes inspect camera.yaml measured_js.yaml masks/0026.png LARGE_NEEDLE_DRIVER_400006.json`

    Parameters
    ----------
    files
        Files or folders of any kind.
    camera
        How to read cameras; the camera of a session of published frames.
    package_path
        NAME=DIR: where the ROS package NAME of package:// paths lies. May be given several times.
    json
        Print a list with an object for each file, and nothing else, on stdout.
    """
    from dvrk_cmaes.inspection import Options, inspect_path
    from dvrk_cmaes.io.atomic import json_text

    options = Options(camera.rectified, camera.side, split_packages(package_path), camera.camera)
    code = 0
    documents = []
    for number, file in enumerate(files):
        try:
            found = inspect_path(file, options)
        except InputError as error:
            code = error.exit_code
            documents.append({"path": str(file), "kind": None, "error": str(error)})
            if not json:
                complain(str(error))
            continue
        documents.append({"path": str(file), **found.to_dict()})
        if not json:
            between = [Line("")] if number else []
            notes = (Line(f"  rule: {text}", "dim") for text in found.notes)
            show([*between, Line(f"{file}: {found.kind}", "bold"), *(Line(f"  {t}") for t in found.lines), *notes])
    if json:
        print(json_text(documents), end="")
    return code
