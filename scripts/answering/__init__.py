"""The cases of scripts/answers.py, and the comparison of their answers."""
