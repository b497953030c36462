"""The beginnings of the pages: the content security policy of each, to the byte, and an escaped title."""

from __future__ import annotations

import re

import pytest

from dvrk_cmaes.report.page_template import TEMPLATES, environment

REST = "base-uri 'none'; form-action 'none'"
STYLE, SCRIPT = "style-src 'sha256-Y'", "script-src 'sha256-X'"
POLICIES = {
    "arms.html": f"default-src 'none'; img-src data:; {STYLE}; {SCRIPT}; {REST}",
    "compare.html": f"default-src 'none'; img-src data:; {STYLE}; {REST}",
    "page.html": f"default-src 'none'; img-src 'self' file: data:; {STYLE}; {SCRIPT}; {REST}",
    "track.html": f"default-src 'none'; img-src data:; {STYLE}; {SCRIPT}; {REST}",
}


@pytest.mark.parametrize("name", POLICIES)
def test_policy_of_each_page(name: str) -> None:
    source = (TEMPLATES / name).read_text(encoding="utf-8")
    (call,) = re.findall(r"{% call head\(.*?\) %}", source)
    begin = '{% from "head.html" import head with context %}' + call + "{{ title }}{% endcall %}"
    values = {"style": "p > b {}", "script": "" if name == "compare.html" else "1 < 2"}
    page = environment().from_string(begin).render(title="<b>", style_hash="sha256-Y", script_hash="sha256-X", **values)
    (policy,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="(.*)">', page)
    assert policy == POLICIES[name]
    assert page.startswith("<!doctype html>\n<html ")
    assert "<title>&lt;b&gt;</title>" in page
    assert "<style>p > b {}</style>\n</head>\n<body>" in page
    assert "<head>" not in source


def test_every_page_has_a_policy() -> None:
    pages = {path.name for path in TEMPLATES.glob("*.html") if "</body>" in path.read_text(encoding="utf-8")}
    assert pages == {*POLICIES}
