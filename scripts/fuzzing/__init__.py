"""The families of scripts/fuzz.py."""
