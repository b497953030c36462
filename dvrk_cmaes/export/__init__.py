"""Export of results and session calibrations to the formats of other programs, one module for each format.

The functions return the contents of the files by name and write nothing. Transforms are named by their direction:
``camera_from_base`` maps points from the frame of the arm's base to the camera frame.
"""
