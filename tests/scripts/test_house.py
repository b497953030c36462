"""scripts/house.py: counts of the source, each checked on source whose counts are known."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.commands import Ran
from helpers.places import ROOT

pytestmark = pytest.mark.usefixtures("scripts_on_path")

SOURCE = '''"""A module
of two lines."""

import ast  # an import

# 0.5 by scripts/bench.py stages, of data/demo
_MEASURED = 0.5
_TUNED = (1, 2)  # px
_GONE = 3  # scripts/no_such_script.py, of data/demo
_NOT_SAID = 4
"""By scripts/bench.py."""


class Held:
    """A class."""

    camera_from_root: float
    at: "Posed"

    def start(self) -> None:
        self.begun = self.at
        text = """two
lines"""
'''


def test_lines_of_code_leave_out_imports_docstrings_and_comments() -> None:
    from house import Module

    assert Module(Path("a.py"), SOURCE).code == 11


def test_source_of_a_constant_names_script_and_data() -> None:
    from house import Module

    assert [*Module(Path("a.py"), SOURCE).constants(ROOT, {})] == [True, False, False, False, False]


def test_measured_change_of_a_constant_is_a_source_as_long_as_it_has_that_value() -> None:
    from house import Module

    module = Module(Path("a.py"), SOURCE)
    assert [*module.constants(ROOT, {("a.py", "_TUNED"): {"(1, 2)"}})] == [True, True, True, False, False]
    assert [*module.constants(ROOT, {("a.py", "_TUNED"): {"(1, 3)"}})] == [True, False, False, False, False]


def test_numbers_of_a_format_of_others_have_a_source_if_the_file_names_it() -> None:
    from house import Module

    for source, known in (("in its/repository", True), ("unknown", False)):
        text = f'"""Files.\n\nSource of the numbers: `Reader` {source}.\n"""\n_SIDE = 1024\n'
        assert [*Module(Path("a.py"), text).constants(ROOT, {})] == [known]


def test_constants_without_a_measurement_become_no_more() -> None:
    from house import counts

    found = {row["of"]: row["count"] for row in counts(ROOT)["figures"]}
    assert found["of these without source"] <= 205


def test_attributes_are_fields_and_what_methods_assign() -> None:
    import ast

    from house import Module, attributes

    (held,) = [node for node in Module(Path("a.py"), SOURCE).nodes if isinstance(node, ast.ClassDef)]
    assert [*attributes(held)] == ["camera_from_root", "at", "begun"]


def test_private_patches_are_counted() -> None:
    from house import Module, private_patches

    text = 'm.setattr("a.b._c", 1)\nm.setattr(a, "_c", 1)\nm.setattr(a, "c", 1)\nm.setattr(a, "__len__", 1)\nf("_c")\n'
    assert private_patches(Module(Path("t.py"), text)) == 2


def test_named_functions_exist_and_one_that_does_not_is_refused(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    from house import NAMED

    for name in " ".join(NAMED.values()).split():
        file = Path("dvrk_cmaes") / name.split(":")[0]
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, tmp_path / file)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_a.py").write_text("start = time.{}()\n".format("perf_counter"), encoding="utf-8")
    report = run_here("house", "--json", "--root", tmp_path).result
    found = {row["of"]: row["count"] for row in report["figures"]}
    assert found["lines of code"] == sum(row["lines"] for row in report["lines of code by package"])
    assert found["tests: files that read clocks"] == 1
    assert {kind: found[kind] for kind in NAMED} == {kind: len(names.split()) for kind, names in NAMED.items()}

    (tmp_path / "dvrk_cmaes" / "calibration" / "frame_fit.py").write_text("", encoding="utf-8")
    refused = run_here("house", "--root", tmp_path)
    assert refused.code == 2
    assert "drivers of a fit: expected a name of dvrk_cmaes, got calibration/frame_fit.py:fit_frame" in refused.err
