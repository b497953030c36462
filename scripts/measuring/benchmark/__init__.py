"""A benchmark of instrument poses on made sessions with known truth: tasks, submissions, methods, scores."""
