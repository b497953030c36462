"""Recordings to session folders: ROS bags, and videos with a table of readings.

recording.py     what both give: images in order, readings over time, a camera
readings.py      readings over time, interpolated to an image's time
topics.py        which of a bag's topics are meant
bag.py           ROS 1 bags and ROS 2 folders, by the library rosbags
messages.py      the parts of a message: image, camera, joints
video.py         a video and its time-stamped readings
write_session.py a session folder, whole or not at all
"""
