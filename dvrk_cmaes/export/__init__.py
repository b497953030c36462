"""Results in the formats of other programs, a module each. Functions return text or arrays; ``run`` writes files.

Every name says its direction: ``camera_from_base`` maps points of the arm's base into the camera.
"""
