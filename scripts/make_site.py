"""Build the documentation site: README, reference pages, gallery, examples and the Python names.

    pip install '.[docs]'
    python scripts/make_site.py --out build/site

Warnings are errors, and so are links and anchors of pages that lead nowhere. The gallery is made by running the
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

from pages.gallery import gallery_page
from pages.python_pages import api_page, example_page

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


def main() -> int:
    """Build the site; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "site", metavar="DIR", help="default: build/site")
    parser.add_argument("--shorter", type=int, default=1, metavar="N", help="draw 1/N of the gallery's recordings")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        docs = Path(folder) / "docs"
        write_sources(docs, Path(folder), options.shorter)
        return 0 if build(docs, options.out.resolve()) else 1


def write_sources(docs: Path, work: Path, shorter: int) -> None:
    """Write the site's pages in Markdown and the files they show; ``work`` is a folder for the gallery's commands."""
    for name in COPIED:
        source, copy = ROOT / name, docs / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, copy)
    shutil.copy(CONFIG.with_name("extra.css"), docs)
    (work / "gallery").mkdir()
    print("gallery:", file=sys.stderr, flush=True)
    made = {
        "gallery.md": gallery_page(docs / "gallery", work / "gallery", shorter=shorter),
        "examples.md": example_page(ROOT / "scripts" / "examples"),
        "api.md": api_page(),
    }
    for name, text in made.items():
        (docs / name).write_text(text, encoding="utf-8")


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
