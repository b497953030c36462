"""Local refinement: Gauss-Newton on the outline, with derivatives in closed form or by differences."""

from __future__ import annotations

DERIVATIVES = ("closed-form", "differences")
"""Ways in which Gauss-Newton finds the derivatives of outlines."""
