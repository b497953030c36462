"""The files of an export, made by the module of its format."""

from __future__ import annotations

from importlib import import_module
from typing import cast

from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.export.table import FORMATS


def export(request: ExportRequest) -> Exported:
    """Make the files of a format.

    Raises
    ------
    InputError
        The source has no ``camera_from_base`` or no frames and the format requires them, or a name is not valid in it.
    """
    module = import_module(f"dvrk_cmaes.export.{FORMATS[request.to].module}")
    return cast(Exported, module.exported(request))
