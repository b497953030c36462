"""Name a test when it fails, not only at the end of the run."""

from __future__ import annotations

import pytest


class NamedFailures:
    """A plugin of pytest that writes a line to the terminal for each test that fails, as soon as it does."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        reporter = self.config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and reporter is not None:
            reporter.ensure_newline()
            reporter.write_line(f"FAILED {report.nodeid}", red=True)
