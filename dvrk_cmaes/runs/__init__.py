"""Resumable, fault-tolerant batch runs.

frame : one frame, from its files to its result and overlay.
pool : what tasks are run by, worker processes or an executor of the caller, and who hears of it.
cluster : a Dask cluster as an executor.
manifest : ``run.json``, which states the inputs of a folder's results: settings, sizes and times of files.
summary : ``summary.json``, and rigs that are calibrated wrongly.
agreement : what all frames of a session state together: frames whose base differs, arms with each other's masks or
readings.
backgrounds : backgrounds that are learned from the images of a session.
batch : `run_batch`, which estimates the frames of a session that have no result, and `finish`, which writes tables and
page.
track, track_inputs, track_outputs : instruments followed through a session folder.
recording, keyframes : the frames of a recording with its clock, solved by keyframes, and all of them.
solver_process : a process that solves keyframes while images are followed.
calibrate_folder : calibration of a session folder.
calibration_pictures : drawings of a frame of a calibrated session.
live_session : processes that run for hours.
"""
