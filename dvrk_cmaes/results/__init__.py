"""Results of frames, and the files and folders that contain them."""
