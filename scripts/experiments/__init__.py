"""The paper's experiments, for scripts/experiment.py."""
