"""Joint readings: what the robot reports for each joint, read from files of several formats.

A reading is the measured position of a joint, rad (insertion: m). The true value is reading + offset.
"""
