"""The notebook: its cells run from top to bottom, and end with a followed instrument."""

from __future__ import annotations

import json
from typing import Any

import pytest
from helpers.places import ROOT, SCRIPTS


def test_notebook_runs_from_a_folder_to_plots(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    monkeypatch.chdir(ROOT)
    notebook = json.loads((SCRIPTS / "examples" / "folder_to_plots.ipynb").read_text(encoding="utf-8"))
    names: dict[str, Any] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    assert len(plt.get_fignums()) == 4
    plt.close("all")
    assert names["followed"].status in ("ok", "doubtful")
    assert capsys.readouterr().out.startswith("5 frames, ")
