"""Baseline for comparisons: poses by perspective-n-point (PnP) from painted markers, or from tips and shaft edges."""
