"""Joint readings: the joint positions reported by the robot, read from files of several formats.

A reading is the position of a joint as the robot reports it, in rad (``insertion``: m). It is evidence for the joint's
value, not the value itself: true value = reading + offset.
"""
