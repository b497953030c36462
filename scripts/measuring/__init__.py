"""The commands of scripts/measure.py."""
