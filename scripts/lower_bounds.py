"""Print the lowest versions that pyproject.toml allows, as constraints for pip: `python scripts/lower_bounds.py`.

Those of the package itself and of its optional libraries, without those for tests and development.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Final

_FOR_DEVELOPMENT: Final = ("test", "lint", "bench", "docs", "make")


def lower_bounds(project: str) -> list[str]:
    """Return a constraint for each library of a pyproject.toml's text; ValueError for one without a lower bound."""
    table = tomllib.loads(project)["project"]
    optional = table["optional-dependencies"]
    wanted = [
        *table["dependencies"],
        *(each for name in optional if name not in _FOR_DEVELOPMENT for each in optional[name]),
    ]
    found = []
    for each in wanted:
        match = re.fullmatch(r"([\w.-]+)>=([\w.]+)(?:,.*)?", each)
        if match is None:
            raise ValueError(f"pyproject.toml: expected a library with a lower bound, got {each}")
        found.append(f"{match[1]}=={match[2]}")
    return found


if __name__ == "__main__":
    print("\n".join(lower_bounds((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))))
