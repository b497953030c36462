"""Videos: FFmpeg prints nothing of its own, whatever it is first used for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CODE = """
import sys
from pathlib import Path
import numpy as np
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.video_frames import Video
from dvrk_cmaes.io.video_writer import whole_video

path = Path("video.mp4")
with whole_video(path, (64, 48), 25.0) as video:
    for number in range(5):
        video.write(np.full((48, 64, 3), 40 * number, np.uint8))
data = bytearray(path.read_bytes())
start = data.index(b"mdat") + 4
for at in range(start, min(start + 400, len(data) - 4), 3):
    data[at] ^= 255
path.write_bytes(data)
try:
    damaged = Video(path)
    for number in range(len(damaged.times)):
        damaged.image(number)
except InputError as error:
    print(error)
"""


def test_damaged_video_prints_nothing_though_a_video_was_written_before(tmp_path: Path) -> None:
    run = subprocess.run([sys.executable, "-c", CODE], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert run.stderr == ""
