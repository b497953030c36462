"""Drawings of results over images: overlays and their text, with OpenCV; figures, with matplotlib."""
