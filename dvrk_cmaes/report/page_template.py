"""Rendering of the HTML templates of pages, each one file with its style and script."""

from __future__ import annotations

import base64
import contextlib
import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import jinja2.bccache

from dvrk_cmaes.io.bundled import cache_folder
from dvrk_cmaes.io.output import write_bytes
from dvrk_cmaes.report.page_frames import (
    NOTHING,
    anchor,
    apart_from,
    axis_angle_deg,
    cells,
    change_in_words,
    degrees,
    fixed,
    position_mm,
    signed,
    sort_keys,
)
from dvrk_cmaes.report.page_layers import outline_path
from dvrk_cmaes.report.page_session import reason_kind
from dvrk_cmaes.report.plots.panels import mark_path, short

TEMPLATES = Path(__file__).resolve().parent / "templates"


def render_template(
    name: str, *, scripts: Iterable[str] = (), styles: Iterable[str] = (), rules: Iterable[str] = (), **values: Any
) -> str:
    """Render a template with page.css, styles and scripts of some names, more rules, and the values it names."""
    code = "\n".join(map(_text, scripts))
    style = "\n".join([*map(_text, ("page.css", *styles)), *rules])
    return (
        environment()
        .get_template(name)
        .render(script=code, style=style, script_hash=_hash(code), style_hash=_hash(style), nothing=NOTHING, **values)
    )


def write_rendered(path: Path, page: str) -> Path:
    """Write a page and return its path; errors as in `dvrk_cmaes.io.output.write_bytes`."""
    write_bytes(path, page.encode("utf-8", errors="replace"))
    return path


@cache
def environment() -> jinja2.Environment:
    """Return the environment of all templates, which keeps those that were compiled."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        bytecode_cache=_compiled(),
    )
    numbers = fixed, signed, degrees, cells, position_mm, axis_angle_deg, apart_from, short
    texts = anchor, reason_kind, mark_path, outline_path, sort_keys, change_in_words
    made.filters |= {each.__name__: each for each in (*numbers, *texts)}
    return made


class _Compiled(jinja2.FileSystemBytecodeCache):
    """Compiled templates in a folder; where it cannot be written to, they are compiled each time."""

    def dump_bytecode(self, bucket: jinja2.bccache.Bucket) -> None:
        with contextlib.suppress(OSError):
            super().dump_bytecode(bucket)


def _compiled() -> jinja2.BytecodeCache | None:
    """Return the cache of compiled templates; compiling takes longer than rendering the page of a few frames."""
    folder = cache_folder()
    if folder is None:
        return None
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return _Compiled(str(folder))


def _text(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Return the hash of a script or style for the page's content security policy."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
