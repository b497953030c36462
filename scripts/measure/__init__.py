"""What scripts/accuracy.py, bench.py and fuzz.py do, a folder for each, and the cases and tables they share."""
