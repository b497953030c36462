"""Reading a ``session.json``."""

from __future__ import annotations

from pathlib import Path

from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.session.document import SessionCalibration


def read_calibration(path: str | Path) -> SessionCalibration:
    """Read a session's calibration; InputError names the file and the field."""
    document = read_json_object(Path(path), expected="a session calibration (session.json)")
    return SessionCalibration.from_dict(document, where=str(path))
