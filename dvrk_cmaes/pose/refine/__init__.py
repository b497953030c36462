"""Local refinement: Gauss-Newton on the outline, the paper's coordinate descent, NLopt's BOBYQA and Sbplx."""

from __future__ import annotations

METHODS = ("gauss-newton", "coordinate-descent", "bobyqa", "sbplx")
"""Names of the refinement methods."""

DERIVATIVES = ("closed-form", "differences")
"""Ways in which Gauss-Newton finds the derivatives of outlines."""
