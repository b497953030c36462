"""Evidence about the pose in one frame: mask, contour, shaft edges, jaw tips and joint readings."""
