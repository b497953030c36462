"""Plots of the pages as SVG: axes, panels of marks and lines, and what each plot shows."""
