"""Frames and session folders: which files a frame has, and what is read from them."""
