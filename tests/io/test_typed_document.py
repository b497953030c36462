"""Documents converted to the classes that declare their fields, and the messages about fields that are wrong."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pytest
from msgspec import Struct

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.typed_document import Count, Number, Point, Texts, Transform, convert_document

HUGE = 10**400


@dataclass(frozen=True)
class Part:
    score: Number
    label: str = ""


class Named(Struct, rename="kebab"):
    base_frame: str


@dataclass(frozen=True, eq=False)
class Whole:
    size: Number
    count: Count = 0
    kind: Literal["near", "far"] = "near"
    notes: Texts = ()
    values: dict[str, Number] = field(default_factory=dict)
    parts: tuple[Part, ...] = ()
    by_name: dict[str, Part] = field(default_factory=dict)
    pose: Transform | None = None
    point: Point | None = None
    named: Named | None = None
    free: dict[str, Any] = field(default_factory=dict)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"size": None}, "size: expected a finite number, got nothing"),
        ({"size": HUGE}, "size: expected a finite number, got 1000"),
        ({"size": -HUGE}, "size: expected a finite number, got -1000"),
        ({"size": float("nan")}, "size: expected a finite number, got nan"),
        ({"size": float("inf")}, "size: expected a finite number, got inf"),
        ({"size": True}, "size: expected a finite number, got True"),
        ({"size": "1"}, "size: expected a finite number, got '1'"),
        ({"count": 1.0}, "count: expected a whole number of at least 0, got 1.0"),
        ({"count": -HUGE}, "count: expected a whole number of at least 0, got -1000"),
        ({"kind": "fat"}, "kind: expected one of far, near, got 'fat'"),
        ({"kind": "\ud800"}, "kind: expected one of near, far, got '\\ud800'"),
        ({"kind": ["far"]}, "kind: expected one of "),
        ({"notes": {}}, "notes: expected a list of texts, got {}"),
        ({"notes": ["a", 3]}, "notes[1]: expected a text, got 3"),
        ({"values": {"a": 1, "b": None}}, "values.b: expected a finite number, got nothing"),
        ({"values": {"a\nb": HUGE}}, "values.a\\nb: expected a finite number, got 1000"),
        ({"parts": "x"}, "parts: expected a list of objects, got 'x'"),
        ({"parts": [{"score": 1}, {}]}, "parts[1].score: expected a finite number, got nothing"),
        ({"by_name": {"a": {"score": 1, "label": 2}}}, "by_name.a.label: expected a text, got 2"),
        ({"pose": [[1, 2], [3]]}, "pose: expected 4 rows of 4 finite numbers, got [[1, 2], [3]]"),
        ({"pose": (2 * np.eye(4)).tolist()}, "pose: expected a rotation and a translation over 0 0 0 1, got [["),
        ({"pose": [[1e300] * 4] * 4}, "pose: expected a rotation and a translation over 0 0 0 1, got [["),
        ({"point": [1, 2, "3"]}, "point: expected 3 finite numbers, got [1, 2, '3']"),
        ({"point": [1, 2, HUGE]}, "point: expected 3 finite numbers, got [1, 2, 1000"),
        ({"point": [1, 2, True]}, "point: expected 3 finite numbers, got [1, 2, True]"),
        ({"named": {"base_frame": "x"}}, "named.base-frame: expected a text, got nothing"),
        ({"named": {"base-frame": []}}, "named.base-frame: expected a text, got []"),
        ({"free": []}, "free: expected an object, got []"),
        ({"\ud800": 1}, "expected an object, got {'size': 1, '\\ud800': 1}"),
    ],
)
def test_wrong_field_is_named(change: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError) as caught:
        convert_document("a.json", {"size": 1, **change}, Whole)
    assert str(caught.value).startswith(f"a.json: {expected}")
    assert len(str(caught.value)) < 200


THREADS = """
import sys
from threading import Barrier, Thread
from msgspec import defstruct
from dvrk_cmaes.io.typed_document import convert_document

sys.setswitchinterval(1e-6)
document = {f"of{k}": {f"in{j}": {"a": 1.0} for j in range(20)} for k in range(5)}
for number in range(100):
    inner = defstruct(f"Inner{number}", [(f"in{k}", dict[str, float | None]) for k in range(20)])
    outer = defstruct(f"Outer{number}", [(f"of{k}", inner) for k in range(5)])
    together = Barrier(4)

    def read():
        together.wait()
        convert_document("a.json", document, outer)

    threads = [Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
"""


def test_threads_that_read_the_first_documents_of_a_class_do_not_crash() -> None:
    ran = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
