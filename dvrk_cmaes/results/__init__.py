"""Results of frames, and the files and folders that they are written to and read from."""
