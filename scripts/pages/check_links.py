"""The check of a built site: links, anchors and pictures that lead nowhere."""

from __future__ import annotations

from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

_ATTRIBUTES: Final = {
    "a": ("href",),
    "img": ("src",),
    "image": ("href", "xlink:href"),
    "link": ("href",),
    "script": ("src",),
    "source": ("src",),
    "video": ("src", "poster"),
    "iframe": ("src",),
}


@dataclass
class _Page(HTMLParser):
    """What a page refers to, and the anchors that it has."""

    links: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)
    text: str = ""

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the references and anchors of an element."""
        for name, value in attrs:
            if value is None:
                continue
            if name == "id" or (tag == "a" and name == "name"):
                self.anchors.add(value)
            elif name in _ATTRIBUTES.get(tag, ()):
                self.links.append(value)


def dead_links(site: Path) -> list[str]:
    """Return what leads nowhere in the HTML pages of a folder, sorted: ``PAGE: LINK``.

    Links to other sites are not followed. An anchor ``#frame-NAME`` may be one that a page's script follows: the name
    must then be among the page's data.
    """
    pages = {path.resolve(): _read(path) for path in site.rglob("*.html")}
    return sorted(
        f"{path.relative_to(site.resolve())}: {link}"
        for path, page in pages.items()
        for link in page.links
        if not _leads_somewhere(link, path, site.resolve(), pages)
    )


def _read(path: Path) -> _Page:
    page = _Page()
    page.text = path.read_text(encoding="utf-8")
    page.feed(page.text)
    return page


def _leads_somewhere(link: str, path: Path, site: Path, pages: dict[Path, _Page]) -> bool:
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return True
    target = path if not parts.path else (path.parent / unquote(parts.path)).resolve()
    if parts.path.startswith("/") or not target.is_relative_to(site):
        return False
    if target.is_dir():
        target /= "index.html"
    if not target.is_file():
        return False
    anchor = unquote(parts.fragment)
    return not anchor or target not in pages or _has_anchor(pages[target], anchor)


def _has_anchor(page: _Page, anchor: str) -> bool:
    """Whether a page has an element with this anchor, or a script with the data of the frame that it names."""
    frame = anchor.removeprefix("frame-")
    return anchor in page.anchors or (frame != anchor and "<script" in page.text and f'"{frame}"' in page.text)
