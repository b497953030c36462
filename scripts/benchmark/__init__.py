"""A benchmark of instrument poses on made sessions with known truth: tasks, submissions, scores, baselines."""
