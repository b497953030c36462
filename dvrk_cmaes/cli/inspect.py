"""``dvrk-cmaes inspect``: kinds and contents of files, as the program reads them."""

from __future__ import annotations

import os
import re
from itertools import chain
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    INSTRUMENT,
    OUTPUT,
    CameraOptions,
    Flag,
    ReadingOptions,
    split_packages,
)
from dvrk_cmaes.cli.terminal import Line, print_error, show
from dvrk_cmaes.errors import InputError


def inspect(
    files: Annotated[tuple[Path, ...], Parameter(negative=())],
    /,
    *,
    camera: CameraOptions = CameraOptions(),
    reading: ReadingOptions = ReadingOptions(),
    package_path: Annotated[tuple[str, ...], Parameter(group=INSTRUMENT, negative=(), show_default=False)] = (),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Print what each file is taken for, what is read from it, and the rules that were applied to ambiguous content.

    Files of cameras, joint readings, masks, images, jaw tips, URDFs, videos and results; folders of sessions and of
    results; the topics of a ROS recording. A folder of frames in the published
    layout is read with the camera of --camera. Masks and images of folders are opened. Exit codes: 0 ok, 2 a file
    could not be read, 3 some of a folder's masks or images would be refused.

    Example:

    ```
    dvrk-cmaes inspect camera.yaml measured_js.yaml masks/0026.png
    ```

    Parameters
    ----------
    files
        Files or folders of any kind, or patterns of these in quotes.
    camera
        How camera files are read; the camera of a folder of frames in the published layout.
    reading
        How files of readings are read.
    package_path
        NAME=DIR: folder of the ROS package NAME, for package://NAME/... paths in a URDF. May be given several times.
    json
        Print only a list with one object for each file, as JSON, on stdout.
    """
    from dvrk_cmaes.inspection import Options, inspect_path
    from dvrk_cmaes.io.json_file import json_text

    packages = split_packages(package_path)
    read_as = reading.read_as()
    options = Options(camera.rectified, camera.side, packages, camera.camera, read_as)
    code = 0
    documents = []
    named = (sorted(file.parent.glob(file.name)) if not os.path.lexists(file) else [] for file in files)
    for number, file in enumerate(chain.from_iterable(of or [file] for of, file in zip(named, files, strict=True))):
        try:
            found = inspect_path(file, options)
        except InputError as error:
            code = error.exit_code
            documents.append({"path": str(file), "kind": None, "error": str(error)})
            print_error(str(error))
            continue
        documents.append({"path": str(file), **found.to_dict()})
        code = code or 3 * bool(found.problems)
        if not json:
            between = [Line("")] if number else []
            notes = (Line(f"  rule: {text}", "dim") for text in found.notes)
            show([*between, Line(f"{file}: {found.kind}", "bold"), *(Line(f"  {t}") for t in found.lines), *notes])
        alike: dict[str, list[str]] = {}
        for problem in found.problems:
            alike.setdefault(re.sub(r"[0-9]+", "", problem.partition(": ")[2]), []).append(problem)
        for first, *more in alike.values():
            print_error(f"{first} (and {len(more)} more like this)" if more else first)
    if json:
        print(json_text(documents), end="")
    return code
