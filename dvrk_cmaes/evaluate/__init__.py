"""Evaluation of results: errors against golden poses, and agreement of a session's frames with each other.

The module `paper` has the numbers that the paper reports.
"""
