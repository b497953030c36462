"""The gallery: commands that are run when the site is built, their pictures, also moving ones, and their pages."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Final

import cv2

from dvrk_cmaes.io.files import bundled_path
from dvrk_cmaes.io.video_writer import quiet_ffmpeg

_INTRODUCTION: Final = """\
# Gallery

What the commands write. All of it was made by the commands shown when this site was built: the bundled session and the
recordings are drawn, so that their truth is known. The pages are those that the commands write, as they are.

The first recording was drawn with this `camera.yaml`:

"""
CAMERA: Final = """\
width: 960
height: 720
K: [1540, 0, 480, 0, 1540, 360, 0, 0, 1]
D: [0, 0, 0, 0, 0]
"""
"""The camera of the first recording, which is in the folder in which the commands are run."""
FOLLOWED: Final = "followed.webp"
"""Name of the moving picture of a folder that `track` wrote."""


@dataclass(frozen=True)
class Exhibit:
    """An entry of the gallery.

    ``commands`` are those of `dvrk-cmaes`, of which the last one writes the folder ``shown``. ``pictures`` and
    ``pages`` are paths in that folder with their texts; of a folder that `track` wrote, followed.webp is made of its
    video.
    """

    title: str
    text: str
    commands: tuple[str, ...]
    shown: str
    pictures: tuple[tuple[str, str], ...]
    pages: tuple[tuple[str, str], ...] = ()


EXHIBITS: Final = (
    Exhibit(
        "A frame",
        "One mask, the camera and the readings. The overlay shows mask and silhouette, what only one of them covers, "
        "and the joints as found and as read.",
        (
            "estimate --mask data/demo/masks/0001.png --camera data/demo/camera.yaml --joints data/demo/joints.csv "
            "--image data/demo/images/0001.jpg --out frame",
        ),
        "frame",
        (("overlays/0001.jpg", "The pose of one frame, drawn over its image"),),
    ),
    Exhibit(
        "A folder of frames",
        "In this frame tissue covers a jaw. The report has all frames, the most doubtful ones first.",
        ("batch data/demo --out results",),
        "results",
        (("overlays/0002.jpg", "The pose of a frame in which tissue covers a jaw"),),
        (("report.html", "the report of the five frames"),),
    ),
    Exhibit(
        "A calibrated session",
        "The base of the arm and the offsets of the joints, from all frames together. The picture shows a frame as the "
        "others predict it, without its own image.",
        ("batch data/demo --out results", "calibrate data/demo --results results --out calibrated"),
        "calibrated",
        (("overlays_left_out/0003.jpg", "A frame as the four others predict it"),),
        (("report.html", "the report of the calibration"),),
    ),
    Exhibit(
        "A followed recording",
        "The silhouette of the pose over the images; the strip has the status. The report shows joints, offsets and "
        "tips over time, and where the pose is doubtful.",
        (
            "synth recording --motion video --level easy --frames 45 --lag 3frames --seed 5 --camera camera.yaml",
            "track recording --every 3 --out tracks",
        ),
        "tracks",
        ((FOLLOWED, "The silhouette of a followed instrument, drawn over the images of the recording"),),
        (("report.html", "the report of the recording"),),
    ),
    Exhibit(
        "A hidden instrument",
        "Another instrument and a piece of tissue pass before the one that is followed. The pose goes on, and is "
        "called doubtful meanwhile.",
        (
            "synth passing --motion video --level medium --frames 82 --seed 7",
            "track passing --every 2 --out hidden",
        ),
        "hidden",
        ((FOLLOWED, "A followed instrument that others hide, drawn over the images of the recording"),),
    ),
    Exhibit(
        "Two arms",
        "Two tools in one recording, each followed without the pixels of the other one, and each in its colour.",
        (
            "synth two --motion video --arms 2 --level easy --frames 30 --seed 1",
            "track two --every 2 --out arms",
        ),
        "arms",
        ((FOLLOWED, "The silhouettes of two followed instruments, drawn over the images of the recording"),),
        (("PSM1/report.html", "the report of the first arm"), ("PSM2/report.html", "the report of the second arm")),
    ),
)


def gallery_page(out: Path, work: Path, exhibits: Sequence[Exhibit] = EXHIBITS, shorter: int = 1) -> str:
    """Run the commands of the exhibits in a new folder, copy what is shown, and return the page in Markdown.

    Parameters
    ----------
    out
        Folder to which the folders that are shown are copied.
    work
        A new folder, in which the commands are run.
    exhibits
        What is shown; a command that several of them name is run once.
    shorter
        Recordings have as many times fewer frames, where the page is made to check it alone.
    """
    (work / "data").symlink_to(bundled_path(), target_is_directory=True)
    (work / "camera.yaml").write_text(CAMERA, encoding="utf-8")
    parts, ran = [_INTRODUCTION + textwrap.indent(CAMERA, "    ")], set[str]()
    for exhibit in exhibits:
        for command in exhibit.commands:
            if command not in ran:
                _run(re.sub(r"(?<=--frames )\d+", lambda count: str(int(count[0]) // shorter), command), work)
                ran.add(command)
        if FOLLOWED in dict(exhibit.pictures):
            moving = moving_picture(work / exhibit.shown, width=960, milliseconds=100, quality=60)
            (work / exhibit.shown / FOLLOWED).write_bytes(moving)
        shutil.copytree(work / exhibit.shown, out / exhibit.shown)
        parts.append(_entry(exhibit, out.name))
    return "\n".join(parts)


def _run(command: str, work: Path) -> None:
    """Run a command, whose messages are shown only if it fails; say which one it is, and how long it took."""
    print(f"  dvrk-cmaes {command}", end="", file=sys.stderr, flush=True)
    began = monotonic()
    line = [sys.executable, "-m", "dvrk_cmaes", *shlex.split(command)]
    ran = subprocess.run(line, cwd=work, capture_output=True, text=True, check=False)
    print(f": {monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    if ran.returncode not in (0, 3):  # ok and doubtful
        raise RuntimeError(f"dvrk-cmaes {command}: exit code {ran.returncode}\n{ran.stderr}")


def _entry(exhibit: Exhibit, folder: str) -> str:
    """Return the entry of an exhibit in Markdown; its files are in a folder beside the page."""
    place = f"{folder}/{exhibit.shown}"
    lines = [f"## {exhibit.title}\n", f"{exhibit.text}\n"]
    lines += [_printed(f"dvrk-cmaes {command}") for command in exhibit.commands]
    lines += [f"\n![{text}]({place}/{path})" for path, text in exhibit.pictures]
    lines += [f"\n[Open {text}]({place}/{path}){{ .md-button }}" for path, text in exhibit.pages]
    return "\n".join([*lines, ""])


def _printed(command: str) -> str:
    """Return a command as a block of code, on several lines if it is long."""
    lines = textwrap.wrap(command, 84, break_long_words=False, break_on_hyphens=False)
    return " \\\n".join([f"    {lines[0]}", *(f"        {line}" for line in lines[1:])])


def moving_picture(tracks: Path, *, width: int, milliseconds: int, quality: int) -> bytes:
    """Encode tracks.mp4 of a folder that `track` wrote, without its first image, as an animated WebP that repeats.

    Once the lag is taken out, no reading is as old as the first image, which is doubtful.

    Parameters
    ----------
    tracks
        The folder.
    width
        Width of the picture, px.
    milliseconds
        Time for which each frame is shown.
    quality
        Quality of the WebP, 0 to 100.
    """
    quiet_ffmpeg()
    capture, images = cv2.VideoCapture(str(tracks / "tracks.mp4")), []
    while True:
        read, image = capture.read()
        if not read:
            break
        size = (width, round(image.shape[0] * width / image.shape[1]))
        images.append(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    animation = cv2.Animation()
    animation.frames, animation.durations, animation.loop_count = images[1:], [milliseconds] * len(images[1:]), 0
    written, data = cv2.imencodeanimation(".webp", animation, [cv2.IMWRITE_WEBP_QUALITY, quality])
    assert written
    return bytes(data.tobytes())
