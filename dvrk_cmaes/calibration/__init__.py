"""Calibration of a session: one camera_from_base and the joints' offsets, estimated from all its frames."""
