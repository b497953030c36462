"""The commands of scripts/accuracy.py."""
