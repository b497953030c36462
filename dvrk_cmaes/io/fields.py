"""Documents read from JSON: fields are checked as they are taken, and a wrong one is named.

``Fields`` wraps an object of a document. Each method takes one field of it; a message says where the document came
from, the field's full name (``quality.iou``), what was expected and what was there.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.short_text import shown

Float64 = NDArray[np.float64]

_RIGID = 1e-4  # how far a rotation may be from orthogonal: what files with few digits have


@dataclass(frozen=True)
class Fields:
    """An object of a document; ``where`` begins each message, e.g. the file's path. Null counts as not there.

    All methods raise `InputError` for a value of another type, and where the field is ``required`` but not there.
    """

    where: str
    values: Mapping[str, Any]
    above: str = ""

    @classmethod
    def of(cls, where: str, document: object) -> Fields:
        """Wrap a document, which must be an object."""
        if not isinstance(document, dict):
            raise InputError(f"{where}: expected an object, got {shown(document)}")
        return cls(where, document)

    def refuse(self, name: str, expected: str) -> InputError:
        """Error that says what was expected of a field."""
        return InputError(f"{self.where}: {self.above}{name}: expected {expected}, got {shown(self.values.get(name))}")

    def has(self, name: str) -> bool:
        """Whether the field is there and not null."""
        return self.values.get(name) is not None

    def text(self, name: str, default: str = "") -> str:
        """Take a text."""
        value = self.values.get(name)
        if value is not None and not isinstance(value, str):
            raise self.refuse(name, "a text")
        return default if value is None else value

    def choice(self, name: str, known: Collection[str], default: str | None = None) -> str:
        """Take one of a few words; without a default one must be there."""
        value = self.values.get(name)
        if value is None and default is not None:
            return default
        if value not in known:
            raise self.refuse(name, f"one of {', '.join(nearest_first(str(value)[:60], known))}")
        return str(value)

    def texts(self, name: str) -> tuple[str, ...]:
        """Take a list of texts, empty where there is none."""
        value = self.values.get(name)
        if value is None:
            return ()
        if not isinstance(value, list) or not all(isinstance(text, str) for text in value):
            raise self.refuse(name, "a list of texts")
        return tuple(value)

    def number(self, name: str, default: float | None = None) -> float:
        """Take a finite number; without a default one must be there."""
        value = self.values.get(name)
        if value is None and default is not None:
            return default
        if value is None or not is_number(value):
            raise self.refuse(name, "a finite number")
        return float(value)

    def count(self, name: str, default: int = 0) -> int:
        """Take a whole number of at least zero."""
        value = self.values.get(name)
        if value is None:
            return default
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise self.refuse(name, "a whole number of at least 0")
        return value

    def numbers(self, name: str, *, required: bool = False) -> dict[str, float]:
        """Take an object of finite numbers by name, empty where there is none."""
        inner = self.inner(name, required=required)
        return {} if inner is None else {key: inner.number(key) for key in inner.values}

    def inner(self, name: str, *, required: bool = False) -> Fields | None:
        """Take an object within this one."""
        value = self.values.get(name)
        if value is None and not required:
            return None
        if not isinstance(value, dict):
            raise self.refuse(name, "an object")
        return Fields(self.where, value, f"{self.above}{name}.")

    def inners(self, name: str) -> list[Fields]:
        """Take a list of objects, empty where there is none."""
        value = self.values.get(name)
        if value is None:
            return []
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            raise self.refuse(name, "a list of objects")
        return [Fields(self.where, entry, f"{self.above}{name}[{k}].") for k, entry in enumerate(value)]

    def array(self, name: str, shape: tuple[int, ...]) -> Float64 | None:
        """Take finite numbers of this shape, rows first."""
        value = self.values.get(name)
        if value is None:
            return None
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            array = np.empty(0)
        if array.shape != shape or not np.isfinite(array).all():
            raise self.refuse(name, f"{' rows of '.join(map(str, shape))} finite numbers")
        return array

    def pose(self, name: str, *, required: bool = False) -> Float64 | None:
        """Take a rigid transform (4, 4), rows first."""
        if required and not self.has(name):
            raise self.refuse(name, "4 rows of 4 finite numbers")
        pose = self.array(name, (4, 4))
        if pose is None:
            return None
        off = np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max()
        if off > _RIGID or np.linalg.det(pose[:3, :3]) < 0 or (pose[3] != [0, 0, 0, 1]).any():
            raise self.refuse(name, "a rotation and a translation over 0 0 0 1")
        return pose


def is_number(value: object) -> bool:
    """Whether a value of a document is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond any float
        return False


def rounded(value: float) -> float:
    """Round to nine decimals: a nanometre, far below any error, and the same on every run."""
    return round(float(value), 9)


def rounded_array(array: Float64) -> Any:
    """Round an array as `rounded` does, to nested lists."""
    return np.round(np.asarray(array, dtype=np.float64), 9).tolist()
