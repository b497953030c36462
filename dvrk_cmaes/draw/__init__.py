"""Drawings of results: overlays over images."""
