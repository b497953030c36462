"""The notebook: its cells run from top to bottom, print what is stored, and end with a recording that is ok."""

from __future__ import annotations

import json
import shlex
import subprocess
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import pytest
from helpers.places import SCRIPTS
from helpers.plain_pictures import small_sessions
from helpers.printed_blocks import run, words


def here(command: list[Any], **_: object) -> None:
    """Run ``python -m dvrk_cmaes`` with its words in this process."""
    assert run(shlex.join(["dvrk-cmaes", *map(str, command[3:])])).code == 0


@pytest.mark.usefixtures("estimates_shared", "searches_short")
def test_notebook_runs_from_a_folder_to_plots_as_its_outputs_show(monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    monkeypatch.chdir(SCRIPTS / "examples")
    monkeypatch.setattr(subprocess, "run", here)
    notebook = json.loads((SCRIPTS / "examples" / "folder_to_plots.ipynb").read_text(encoding="utf-8"))
    names: dict[str, Any] = {}
    figures = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            stored, printed = cell["outputs"], StringIO()
            with redirect_stdout(printed), small_sessions():
                exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
            shown = "".join(text for one in stored if one["output_type"] == "stream" for text in one["text"])
            assert words(printed.getvalue()) == words(shown)
            assert len(plt.get_fignums()) == sum("image/jpeg" in one.get("data", {}) for one in stored)
            figures += len(plt.get_fignums())
            plt.close("all")
    assert figures == 5
    assert names["followed"].status == "ok"
