"""The table of ``dvrk-cmaes compare --labels``: how far from labelled points sets of poses put them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvrk_cmaes.cli.terminal import Line
from dvrk_cmaes.io.short_text import natural

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dvrk_cmaes.evaluate.compared_set import ComparedSet
    from dvrk_cmaes.evaluate.label_errors import LabelErrors, Labels
    from dvrk_cmaes.instrument import Instrument


@dataclass(frozen=True, eq=False)
class LabelTable:
    """The errors of each set of poses at the same labels."""

    labels: Labels
    sets: tuple[LabelErrors, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        paths = {"path": str(self.labels.path), "points": str(self.labels.table_path)}
        names = {"used": self._used, "left_out": list(self.labels.left_out)}
        return {**paths, **names, "sets": [found.to_dict() for found in self.sets]}

    @property
    def _used(self) -> list[str]:
        """The labels whose points the table has, numbers in their order."""
        names = dict.fromkeys(name for own in self.labels.pixels.values() for name in own)
        return sorted(names, key=natural)

    def lines(self) -> Iterator[Line]:
        """Yield the rows of each set: all labels together, and each by itself."""
        yield Line(f"labels: {self.labels.path}, their points by {self.labels.table_path}")
        yield Line(f"  used: {', '.join(self._used)}")
        if self.labels.left_out:
            left_out = ", ".join(sorted(self.labels.left_out, key=natural))
            yield Line(f"  left out, for the table has no point of them: {left_out}", "yellow")
        if self.labels.table_path.name == "surgpose.json":
            yield Line(
                "  it is not verified which points SurgPose's labels mean; --points FILE replaces the table", "yellow"
            )
        for found in self.sets:
            title = f"{found.path}, {len(found.by_frame)} frames"
            yield Line(f"{title:<30}  points    mean  median    95 %  largest, px", "bold")
            if not found.by_frame:
                yield Line("  no frame has a pose", "yellow")
                continue
            yield _row("all", found.all)
            for name, errors in sorted(found.by_label.items(), key=lambda item: natural(item[0])):
                yield _row(f"label {name}", errors)
            if found.without:
                yield Line(f"  labels in frames without a pose: {len(found.without)} frames", "yellow")


def label_table(sets: Sequence[ComparedSet], session: Path, points: Path | None, instrument: Instrument) -> LabelTable:
    """Measure sets of poses at the labels of a session; errors as `read_labels` and `label_errors`."""
    from dvrk_cmaes.evaluate.label_errors import label_errors, read_labels

    labels = read_labels(session, points)
    return LabelTable(labels, tuple(label_errors(compared, labels, instrument) for compared in sets))


def _row(name: str, errors: NDArray[Any]) -> Line:
    """Return the row of a label's errors (N,), px."""
    from dvrk_cmaes.evaluate.label_errors import summary_px

    cells = "".join(f"{value:>8.2f}" for value in summary_px(errors).values())
    return Line(f"  {name:<28}  {len(errors):>6d}{cells}")
