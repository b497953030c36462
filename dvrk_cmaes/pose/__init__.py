"""Pose estimation in one frame: global search, local refinement, quality and covariance."""
