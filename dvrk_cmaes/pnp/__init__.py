"""Baseline for comparisons: the pose from detections of painted markers by perspective-n-point (PnP)."""
