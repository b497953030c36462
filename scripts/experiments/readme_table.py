"""Write the claims of all experiments, and whether they hold, into data/reference/experiments.md.

    python scripts/experiments/readme_table.py

Reads data/experiments/*.json, and replaces what is between two marked lines of the page. Quick runs are refused.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from experiment import OUT, ROOT, table

from dvrk_cmaes.io.atomic import write_text

BEGIN: Final = "<!-- experiments: made by scripts/experiments/readme_table.py -->"
END: Final = "<!-- end of experiments -->"
ORDER: Final = ("table1", "figure4", "table2", "ablation")
PAGE: Final = ROOT / "data" / "reference" / "experiments.md"


def claims_table(documents: Mapping[str, Mapping[str, Any]], folder: str) -> str:
    """Lay out the claims of all experiments, and where and when each ran; ``folder`` is the links' folder."""
    rows = [
        (
            f"[{document['title'].split(':')[0]}]({folder}/{name}.md)" if k == 0 else "",
            claim["text"],
            "yes" if claim["holds"] else "**no**",
            claim["figures"],
        )
        for name, document in documents.items()
        for k, claim in enumerate(document["claims"])
    ]
    ran = [
        f"{document['title'].split(':')[0]}: {document['ran']['date']}, commit {document['ran']['commit']}, "
        f"{document['ran']['minutes']:g} min"
        for document in documents.values()
    ]
    machines = dict.fromkeys(document["ran"]["machine"] for document in documents.values())
    return "\n".join(
        [
            table(("experiment", "what it should show", "holds", "figures"), rows),
            "",
            f"Run on {' and '.join(machines)}. {'; '.join(ran)}.",
        ]
    )


def with_table(page: str, text: str) -> str | None:
    """Replace what is between the marked lines of a page; None if it does not have them."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{text}\n\n{END}{after}" if begin and end else None


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=OUT, metavar="DIR", help="folder of the experiments' JSON")
    parser.add_argument("--page", type=Path, default=PAGE, metavar="FILE", help="file to change")
    given = parser.parse_args(arguments)
    paths = [given.results / f"{name}.json" for name in ORDER]
    missing = [path for path in paths if not path.exists()]
    if missing:
        return _complain(f"{missing[0]}: no such file; expected the result of an experiment (make experiments)")
    documents = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths}
    quick = [name for name, document in documents.items() if document["ran"]["quick"]]
    if quick:
        return _complain(f"{given.results / quick[0]}.json: expected a full run, got a quick one")
    folder = Path(os.path.relpath(given.results.resolve(), given.page.resolve().parent)).as_posix()
    changed = with_table(given.page.read_text(encoding="utf-8"), claims_table(documents, folder))
    if changed is None:
        return _complain(f"{given.page}: expected the lines {BEGIN} and {END}, got none; nothing changed")
    write_text(given.page, changed)
    return 0


def _complain(text: str) -> int:
    print(f"readme_table.py: {text}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
