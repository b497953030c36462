"""The list of commands says of each what the first sentence of its own help says."""

from __future__ import annotations

import pytest

from dvrk_cmaes.cli.app import SUMMARIES, app


@pytest.mark.parametrize("name", SUMMARIES)
def test_listed_text_is_the_first_sentence_of_the_command(name: str) -> None:
    assert " ".join(app[name].help.partition("\n\n")[0].split()) == SUMMARIES[name]
