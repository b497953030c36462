"""Build the documentation site: README, reference pages, gallery, examples and the Python names.

    pip install '.[docs]'
    python scripts/make_site.py --out build/site

Warnings are errors, and so are links, anchors and pictures that lead nowhere. The gallery is made by running the
commands that it shows, in some minutes; each is named with the time that it took.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from pages.api_page import api_page
from pages.check_links import dead_links
from pages.example_page import example_page
from pages.gallery import EXHIBITS, FOLLOWED, Exhibit, gallery_page

ROOT: Final = Path(__file__).resolve().parents[1]
CONFIG: Final = ROOT / "scripts" / "pages" / "mkdocs.yml"
COPIED: Final = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "CITATION.cff",
    *(f"data/{name}" for name in ("reference", "measurements", "experiments", "docs")),
)
"""Files and folders that keep their places on the site, so that links between them are those of the repository."""


LARGER: Final = f"hidden/{FOLLOWED}"
"""The moving picture of the gallery that takes the place of the README's smaller one."""


def main() -> int:
    """Build the site and check its links; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "site", metavar="DIR", help="default: build/site")
    out = parser.parse_args().out.resolve()
    with tempfile.TemporaryDirectory() as folder:
        docs = Path(folder) / "docs"
        write_sources(docs, Path(folder))
        if not build(docs, out):
            return 1
    dead = dead_links(out)
    print(*(f"leads nowhere: {link}" for link in dead), sep="\n", end="\n" if dead else "", file=sys.stderr)
    print(f"{out}: {len(list(out.rglob('*.html')))} pages, {len(dead)} links that lead nowhere")
    return 1 if dead else 0


def write_sources(docs: Path, work: Path, exhibits: tuple[Exhibit, ...] = EXHIBITS) -> None:
    """Write the site's pages in Markdown and the files they show; ``work`` is a folder for the gallery's commands."""
    for name in COPIED:
        source, copy = ROOT / name, docs / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, copy)
        else:
            shutil.copy(source, copy)
    shutil.copy(CONFIG.with_name("extra.css"), docs)
    (work / "gallery").mkdir()
    print("gallery:", file=sys.stderr, flush=True)
    made = {
        "gallery.md": gallery_page(docs / "gallery", work / "gallery", exhibits),
        "examples.md": example_page(ROOT / "scripts" / "examples"),
        "api.md": api_page(),
    }
    for name, text in made.items():
        (docs / name).write_text(text, encoding="utf-8")
    larger = docs / "gallery" / LARGER
    if larger.is_file():  # the start shows the recording as large as the gallery does
        shutil.copy(larger, docs / "data" / "docs" / larger.name)


def build(docs: Path, out: Path) -> bool:
    """Build the site of a folder of sources, and return whether there was neither an error nor a warning."""
    line = [sys.executable, "-m", "mkdocs", "build", "--config-file", str(CONFIG), "--site-dir", str(out)]
    environment = {**os.environ, "SITE_DOCS": str(docs), "NO_MKDOCS_2_WARNING": "1"}
    print("pages: mkdocs", file=sys.stderr, flush=True)
    ended = subprocess.run(line, env=environment, check=False).returncode
    (out / "404.html").unlink(missing_ok=True)  # its links hold only where the site is at the root of its host
    return ended == 0


if __name__ == "__main__":
    sys.exit(main())
