"""Drawings of results: overlays over images with OpenCV, and figures with matplotlib."""
