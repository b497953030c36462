"""``dvrk-cmaes synth``: sessions with known truth, at levels that can be cited."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    DEFAULT_CAMERA,
    DEFAULT_INSTRUMENT,
    OUTPUT,
    CameraOptions,
    Flag,
    InstrumentOptions,
)
from dvrk_cmaes.cli.terminal import Line, show
from dvrk_cmaes.errors import InputError

_MOST_FRAMES = 100_000


def synth(
    out: Path,
    /,
    *,
    level: Literal["clean", "easy", "medium", "hard"] = "medium",
    motion: Literal["free", "rcm"] = "rcm",
    frames: int = 10,
    seed: int = 0,
    images: bool = True,
    overwrite: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    camera: CameraOptions = DEFAULT_CAMERA,
    instrument: InstrumentOptions = DEFAULT_INSTRUMENT,
) -> int:
    """Make a session whose truth is known, in the layout of any session folder.

    An arm moves the instrument about its remote centre of motion (rcm), with one camera_from_base and outer readings;
    or each frame shows it anywhere (free). Masks are those of a segmenter with its mistakes, readings are wrong as a
    robot's are: mostly by one bias a session, in every frame nearer to the truth than to its mirror twin. Beside masks,
    images and readings there are tips (keypoints.csv), painted markers as a detector finds them (markers.csv), the
    truth (golden.json) and all figures (synth.json).

    Unless another is given, the camera has 640 x 480 pixels and a focal length of 1026 px.

    A level's figures, the readings' in deg rms over many sessions (the jaw's is 1.5 times the wrist's; yaw and pitch
    0.1 deg, insertion 0.4 mm at all levels):

    - clean: wrist 5, roll 5; mask exact to the pixel; markers 1.0 px.

    - easy: wrist 2, roll 2; outline wavers by 0.4 px; markers 1.5 px.

    - medium: wrist 5, roll 5; outline wavers by 0.9 px, logits of 2 px, 3 lumps or bites of 2 to 5 px, 2 lost
      highlights; tissue before a jaw in 20 % of the frames, always in ignore/; barrel lens with a round picture, whose
      edge is ignored; markers 2.5 px.

    - hard: wrist 8, roll 8; outline wavers by 1.5 px, logits of 4 px, 6 lumps or bites of 3 to 9 px, 4 lost
      highlights; tissue before a jaw in 70 % of the frames, in ignore/ for half of these; lens as medium; markers
      4.0 px.

    Example:

    `dvrk-cmaes synth sessions/hard --level hard --frames 20 --seed 3`

    Parameters
    ----------
    out
        Folder to write the session to, new or empty.
    level
        How hard it is; cite level, motion, seed and version.
    motion
        An arm about its remote centre, or free poses without outer joints.
    frames
        How many frames.
    seed
        Seed of all random numbers; the same seed gives the same session.
    images
        Draw images, too.
    overwrite
        Replace an older made session.
    camera
        Which camera.
    instrument
        Which instrument.
    """
    if not 1 <= frames <= _MOST_FRAMES:
        raise InputError(f"--frames: expected 1 to {_MOST_FRAMES}, got {frames}")
    if seed < 0:
        raise InputError(f"--seed: expected a whole number of at least 0, got {seed}")
    from dvrk_cmaes.frames.markers import read_marker_table
    from dvrk_cmaes.io.bundled import bundled_path
    from dvrk_cmaes.synth.levels import LEVELS
    from dvrk_cmaes.synth.session import SessionPlan, default_camera, write_session

    body = instrument.load()
    table = read_marker_table(bundled_path("markers", "lnd.json"))
    links = {body.instrument.root_link, *(joint.child for joint in body.instrument.chain.joints)}
    painted = all(marker.link in links for marker in table.values())
    plan = SessionPlan(
        body=body,
        camera=default_camera(LEVELS[level]) if camera.camera is None else camera.read().camera,
        level=LEVELS[level],
        motion=motion,
        frames=frames,
        seed=seed,
        markers=table if painted else {},
        arm=instrument.arm,
    )
    write_session(out, plan, images=images, overwrite=overwrite)
    show([Line(f"{frames} frames, level {level}, motion {motion}, seed {seed}; written: {out}")])
    return 0
