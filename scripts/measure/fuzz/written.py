"""Files that commands wrote, for scripts/fuzz.py: whether they are whole, and their contents without times."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_image

_TIMES: Final = ("seconds", "timing", "run", "frame_seconds")
_READERS: Final[dict[str, Callable[[Path], Any]]] = {
    ".json": lambda path: json.loads(path.read_text()),
    ".jpg": read_image,
    ".png": read_image,
}


def damaged_files(made: Path) -> list[str]:
    """Return which documents and pictures of a command are not whole; temporary files do not count."""
    found = []
    for path in [made] if made.is_file() else sorted(made.rglob("*")):
        if not path.name.startswith(".") and (read := _READERS.get(path.suffix)) is not None:
            try:
                read(path)
            except (ValueError, InputError) as error:
                found.append(f"{path.name} is damaged: {error}")
    return found


def written(made: Path) -> dict[str, Any]:
    """Return the contents of a file or of a folder's files by name, without times; of a page and a video, nothing."""
    files = [made] if made.is_file() else [path for path in made.rglob("*") if path.is_file()]
    return {str(path.relative_to(made.parent)): _content(path) for path in files if not path.name.startswith(".")}


def _content(path: Path) -> Any:
    match path.suffix:
        case ".html" | ".mp4":
            return None
        case ".json":
            return _without_times(json.loads(path.read_text()))
        case ".jsonl":
            return [_without_times(json.loads(line)) for line in path.read_text().splitlines()]
        case ".csv":
            rows = [line.split(",") for line in path.read_text().splitlines()]
            skipped = {k for k, name in enumerate(rows[0]) if name == "seconds"}
            return [[cell for k, cell in enumerate(row) if k not in skipped] for row in rows]
    return path.read_bytes()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_times(inner) for name, inner in value.items() if name not in _TIMES}
    return [_without_times(inner) for inner in value] if isinstance(value, list) else value
