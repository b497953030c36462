"""Import of recordings into session folders: ROS bags, videos with a table of readings, and public data sets.

The modules in the table of ``readers`` open a recording as a ``Recording`` (module ``recording``), which
``write_session`` writes as a session folder. ``topics`` selects the topics of a bag, ``messages`` and ``camera``
convert its messages, and ``pose_table`` finds the joints of Cartesian poses.
"""
