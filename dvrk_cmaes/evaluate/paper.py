"""Numbers that the paper reports, for comparison: Liang, Chiu, Richter and Yip, 2025, arXiv 2503.05953."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class TableOneRow:
    """Standard deviations of the axes' distances from their converging point, m: the paper's method, and PnP."""

    sigma_m: float
    pnp_sigma_m: float


TABLE_ONE: Final = {
    "easy": TableOneRow(0.00046, 0.05456),
    "medium": TableOneRow(0.00243, 0.06173),
    "hard": TableOneRow(0.00253, 0.06761),
}
"""The paper's Table I, ten frames each."""
