"""Comparing results: with each other, with the paper's figures, and with the poses of an earlier method."""
