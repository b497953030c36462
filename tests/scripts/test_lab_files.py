"""Files as other laboratories have them: each is read with the right value, or refused with the remedy."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.canned_results import canned, write_results
from helpers.places import SCRIPTS
from helpers.plain_pictures import plain_pictures

from dvrk_cmaes.results.result import ExpectedError


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        from measure.fuzz.runs import stubbed

        folder = tmp_path_factory.mktemp("material")
        result = canned(
            "0000",
            covariance=np.diag([2e-4] * 3 + [0.01] * 6) ** 2,
            expected_error=ExpectedError({"mean": 1.1}, {}, 1.1, 0.5),
        )
        write_results(folder / "results", result)
        with stubbed(folder), plain_pictures():
            yield


def test_files_of_many_kinds_are_read_or_refused_with_the_remedy(material: None, tmp_path: Path) -> None:
    from measure.fuzz.lab_files import CASES
    from measure.fuzz.runs import in_this_process

    assert len({case.name for case in CASES}) == len(CASES) >= 40
    problems = {}
    for case in CASES:
        folder = tmp_path / case.name.replace("/", " ")
        folder.mkdir()
        problem = case.problem(folder, in_this_process)
        if problem is not None:
            problems[case.name] = problem
    assert problems == {}
