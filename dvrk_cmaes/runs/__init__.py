"""Resumable, fault-tolerant batch runs.

frame : one frame, from its files to its result and overlay.
pool : worker processes, and running many tasks in them or in an executor of the caller.
worker : one frame of a batch in a worker process.
cluster : a Dask cluster as an executor.
manifest : ``run.json``, which states the inputs of a folder's results: settings, sizes and times of files.
output : the output folder of a batch: its frames by pattern, complete results, and writing.
summary : ``summary.json``, and rigs that are calibrated wrongly.
agreement : what all frames of a session state together: frames whose base differs, arms with each other's masks or
readings.
batch : `run_batch`, which estimates the frames of a session that have no result, and `finish`, which writes tables and
page.
track, track_inputs, track_outputs : instruments followed through a session folder.
keyframes, recording : a recording that is solved by its keyframes, and by all its frames.
calibrate_folder : calibration of a session folder.
calibration_pictures : drawings of a frame of a calibrated session.
"""
