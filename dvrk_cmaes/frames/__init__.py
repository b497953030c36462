"""Frames of a session and their files: masks, images, readings, keypoints, markers and known poses."""
