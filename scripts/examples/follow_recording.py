"""Follow an instrument through a recording, image by image, as a program beside a running robot would.

    dvrk-cmaes synth recording --motion video --level easy --frames 30
    python scripts/examples/follow_recording.py recording

The argument is a session folder with consecutive masks and with times in its joints.csv.
"""

from __future__ import annotations

import sys

from dvrk_cmaes import InputError, Tracker, prepare, read_frame, read_session


def main(folder: str) -> None:
    session = read_session(folder)
    tracker = Tracker(session.camera, prepare("lnd"))
    for files in session.frames:
        if files.time is None:  # s
            raise InputError(
                f"{folder}: expected consecutive masks, and times in joints.csv, got no time of {files.name}"
            )
        tracker.add_readings(files.time, files.readings)  # at any rate, also between the images
        mask = read_frame(files, session.camera).mask  # (H, W) bool
        pose = tracker.step(files.time, mask)
        if tracker.solution_due:  # beside a running robot, by another process: tracker.problem() can be pickled
            tracker.use(tracker.solve())
        if pose.status == "lost" or pose.tips is None:
            print(f"{files.name}: lost")
            continue
        u, v = session.camera.project(pose.tips.mean(axis=0))
        doubts = "".join(f"; {reason}" for reason in pose.reasons)
        print(f"{files.name}: {pose.status}, tips at pixel {u:.0f} {v:.0f}, {1e3 * pose.seconds:.0f} ms{doubts}")
    offsets = {name: round(value, 3) for name, value in tracker.offsets.items()}
    print(f"true = reading + offset, rad: {offsets}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        print("expected a session folder with consecutive masks, and with times in its joints.csv", file=sys.stderr)
        sys.exit(2)
    try:
        main(*sys.argv[1:])
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
