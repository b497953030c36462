"""Import of recordings into session folders: ROS bags, videos with a table of readings, and clips of SurgSync.

``bag``, ``video``, ``stereo_videos`` and ``surgsync`` open a recording as a ``Recording`` (module ``recording``), which
``write_session`` writes as a session folder. ``topics`` selects the topics of a bag, ``messages`` and ``camera``
convert its messages, ``surgsync_frame`` reads the files of a frame of a clip, and ``reading_table`` reads time-stamped
readings from a file.
"""
