"""The types of the compiled module are those that the checkers see."""

from __future__ import annotations

import pytest


@pytest.mark.usefixtures("scripts_on_path")
def test_stub_is_up_to_date() -> None:
    from make_kernel_stub import STUB, stub

    assert STUB.read_text(encoding="utf-8") == stub()
