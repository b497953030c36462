"""Following an instrument on a running robot: images and readings come from ROS topics, poses go to ROS topics.

``connection`` is what a way to ROS has to offer, ``rosbridge`` the one over a websocket and ``rclpy_node`` a node of
ROS 2. ``inputs`` keeps the newest messages, which ``messages`` converts; ``loop`` gives them to a tracker, and
``outputs`` publishes its results.
"""
