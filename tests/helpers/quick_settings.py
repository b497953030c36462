"""Settings of few evaluations for commands without a settings file, for tests whose subject is not the accuracy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from dvrk_cmaes.cli.options import MethodOptions
from dvrk_cmaes.config import EstimateConfig
from helpers.batch_sessions import QUICK_CONFIG


@contextmanager
def quick_settings() -> Iterator[None]:
    """Let commands take these settings, but for those that their options give."""
    resolve = MethodOptions.resolve

    def quick(self: MethodOptions) -> EstimateConfig:
        given = resolve(self)
        if self.config is not None:
            return given
        search = replace(QUICK_CONFIG.search, method=given.search.method)
        refine = replace(QUICK_CONFIG.refine, method=given.refine.method)
        return replace(given, search=search, refine=refine)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MethodOptions, "resolve", quick)
        yield
