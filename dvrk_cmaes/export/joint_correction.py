"""Corrections of the readings of roll, wrist and jaw, as a table over the readings and as a short formula."""

from __future__ import annotations

from itertools import product
from typing import Any, Final

import numpy as np
from msgspec import Struct

from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.typed_document import Number, convert_document, refused
from dvrk_cmaes.joints.cables import CableModel
from dvrk_cmaes.joints.play import NARROW

Rows = tuple[tuple[Number, ...], ...]

_WRIST_DEG: Final = tuple(range(-60, 61, 15))
_JAW_DEG: Final = tuple(range(0, 61, 20))


class _Alone(Struct):
    """Fields of ``cables.alone`` in session.json."""

    offset: tuple[Number, ...]
    coupling: Rows


class _Cables(Struct):
    """Fields of ``cables`` in session.json."""

    joints: tuple[str, ...]
    reference: tuple[Number, ...]
    coupling: Rows
    play: Rows
    narrow: tuple[Number, ...]
    width: tuple[Number, ...]
    alone: _Alone


class _Session(Struct):
    """Fields of session.json."""

    offsets: dict[str, Number]
    cables: _Cables | None = None


def correction_files(where: str, document: dict[str, Any], names: FrameNames) -> dict[str, str]:
    """Return the table and the formula of a session calibration's document, by file name.

    Corrections are added to readings: true = reading + correction. The table has what the readings of a moment tell by
    themselves; the formula has the play, too, which depends on the readings before.

    Raises
    ------
    InputError
        A field is missing or wrong.
    """
    session = convert_document(where, document, _Session)
    joints = tuple(session.offsets)[1:]
    offset = np.array([session.offsets[name] for name in joints])
    cables = session.cables
    count = len(joints)
    if cables is None:
        none = np.zeros((count, count))
        whole = alone = _linear(joints, np.zeros(count), offset, none)
    else:
        _check(where, cables, joints)
        reference = np.array(cables.reference)
        alone = _linear(joints, reference, np.array(cables.alone.offset), np.array(cables.alone.coupling))
        parts = (np.array(getattr(cables, name)) for name in ("coupling", "play", "narrow", "width"))
        whole = CableModel(joints, reference, offset, *parts, *np.zeros((3, count)))
    stem = f"{names.arm}-joint-correction"
    return {f"{stem}.csv": _table(alone), f"{stem}.txt": _formula(whole)}


def _check(where: str, cables: _Cables, joints: tuple[str, ...]) -> None:
    """Raise InputError if there is not a value for each joint."""
    count = len(joints)
    if cables.joints != joints:
        raise refused(where, "cables.joints", ", ".join(joints), list(cables.joints))
    vectors = {"reference": cables.reference, "narrow": cables.narrow, "width": cables.width}
    for name, row in (vectors | {"alone.offset": cables.alone.offset}).items():
        if len(row) != count:
            raise refused(where, f"cables.{name}", f"{count} numbers, one a joint", list(row))
    for name, rows in (("coupling", cables.coupling), ("play", cables.play), ("alone.coupling", cables.alone.coupling)):
        if len(rows) != count or any(len(row) != count for row in rows):
            raise refused(where, f"cables.{name}", f"{count} rows of {count} numbers", [list(row) for row in rows])


def _linear(joints: tuple[str, ...], reference: Float64, offset: Float64, coupling: Float64) -> CableModel:
    """Return a model of offsets (C,) and coupling (C, C) alone."""
    none = np.zeros(len(joints))
    return CableModel(joints, reference, offset, coupling, np.zeros_like(coupling), *[none] * 5)


def _table(model: CableModel) -> str:
    """Return the corrections over a grid of the readings of the instrument's joints, in degrees, with roll at rest."""
    own = model.names[1:]
    axes = [_JAW_DEG if name == "jaw" else _WRIST_DEG for name in own]
    lines = [",".join([*(f"{name}_deg" for name in own), *(f"{name}_correction_deg" for name in model.names)])]
    for place in product(*axes):
        off = np.concatenate([[0.0], np.deg2rad(place) - model.reference[1:]])
        correction = np.degrees(model.offset + model.coupling @ off)
        lines.append(",".join([*map(str, place), *(f"{value:.3f}" for value in correction)]))
    return "\n".join(lines) + "\n"


def _formula(model: CableModel) -> str:
    """Return the corrections as lines of arithmetic that a controller carries out at each reading, in radians."""
    lines = ["# rad; roll and the joints' names stand for readings; true = reading + correction"]
    if model.play.any() or model.narrow.any():
        lines.append("# at each reading, in the order of time; before the first: wide_X = narrow_X = X")
        for name, width in zip(model.names, model.width.tolist(), strict=True):
            for band, size in (("wide", width), ("narrow", NARROW * width)):
                place = f"{band}_{name}"
                lines.append(f"{place} = min(max({place}, {name} - {size:.5f}), {name} + {size:.5f})")
    for j, name in enumerate(model.names):
        terms = [f"{model.offset[j]:+z.5f}"]
        for k, other in enumerate(model.names):
            if model.coupling[j, k]:
                terms.append(f"{model.coupling[j, k]:+z.5f} * ({other} - {model.reference[k]:.5f})")
        for k, other in enumerate(model.names):
            if model.play[j, k]:
                terms.append(f"{model.play[j, k]:+z.5f} * (wide_{other} - {other})")
        if model.narrow[j]:
            terms.append(f"{model.narrow[j]:+z.5f} * (narrow_{name} - {name})")
        lines.append(f"{name}_correction = {' '.join(terms)}")
    return "\n".join(lines) + "\n"


def exported(request: ExportRequest) -> Exported:
    """Export the correction of a session calibration; InputError if there is none."""
    return Exported.of_texts(correction_files(*request.source.calibration(), request.names))
