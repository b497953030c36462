"""Import of recordings into session folders: ROS bags, and videos with a table of readings.

``bag`` and ``video`` open a recording as a ``Recording`` (module ``recording``), which ``write_session`` writes as a
session folder. ``topics`` selects the topics of a bag, ``messages`` and ``camera`` convert its messages, and
``reading_table`` reads time-stamped readings from a file.
"""
