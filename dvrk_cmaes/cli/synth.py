"""``dvrk-cmaes synth``: synthetic sessions with known truth, at fixed levels of difficulty."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from dvrk_cmaes.cli.options import OUTPUT, CameraOptions, Flag, SeedOption, UrdfOptions, options, whole
from dvrk_cmaes.cli.terminal import Line, show
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.frames.session_toml import ToolEntry
    from dvrk_cmaes.synth.session import SessionPlan

_MOST_FRAMES = 100_000
_BASELINE = 0.0053  # m, between the eyes


@options(group=OUTPUT)
class SynthOptions:
    """What is drawn.

    Parameters
    ----------
    level
        Level of difficulty. Cite a session by level, motion, seed and version.
    motion
        rcm: an arm moves about its remote centre of motion. free: independent poses, without readings of outer joints.
        video: consecutive frames of a moving arm, for `track`.
    frames
        Number of frames, 1 to 100000.
    lag
        Lag of a video's images behind its readings, in seconds or frames, such as 0.13 or 4frames; that of the level by
        default.
    stereo
        Two eyes, 5.3 mm apart: masks/left, masks/right and so on, left.yaml and right.yaml. The truth is in the left
        camera.
    arms
        2: two arms whose tools cross, up to 30 % of a tool hidden by the other: masks of labels, a session.toml,
        joints_ARM.csv and golden_ARM.json of each arm; alone/ARM has the masks of each tool without the other. Of
        --motion video with images, a lag and cables of each arm's own, and --stereo; the second arm has that of six
        motions in which the tools cross most. Of --motion rcm without images.
    seed
        Seed of all random numbers, a whole number of at least 0; the same seed gives the same session.
    images
        Write images as well.
    mp4
        Write the images of --motion video, of one eye, as video.mp4, not as files in images/.
    ecm
        The endoscope of --motion video is steered three times, by 5 to 30 mm and 5 to 25 deg. joints.csv has the
        readings of its arm (ecm_yaw, ecm_pitch, ecm_insertion, ecm_roll), whose errors are offsets of 2 deg and 2 mm,
        and 0.3 deg and 0.5 mm that differ from place to place; golden.json has the camera in the endoscope's tip, the
        arm's base in that of the endoscope's arm, the offsets, and camera_from_base of each frame.
    """

    level: Literal["clean", "easy", "medium", "hard"] = "medium"
    motion: Literal["free", "rcm", "video"] = "rcm"
    frames: Annotated[int, whole(1, _MOST_FRAMES)] = 10
    lag: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    stereo: Flag = False
    arms: Literal[1, 2] = 1
    seed: SeedOption = 0
    images: bool = True
    mp4: Flag = False
    ecm: Flag = False

    def check(self) -> None:
        """Raise an InputError for values that are not valid, or do not fit together."""
        for option, given in (("--lag", self.lag is not None), ("--ecm", self.ecm)):
            if given and self.motion != "video":
                raise InputError(f"{option}: expected it with --motion video only, got --motion {self.motion}")
        if self.mp4 and (self.motion != "video" or not self.images or self.stereo):
            raise InputError("--mp4: expected it with --motion video, --images and one eye only")
        if self.arms > 1 and (self.motion == "free" or (self.stereo and self.motion == "rcm")):
            raise InputError("--arms: expected --motion video, or --motion rcm and one eye, with two arms")

    def plan(self, camera: CameraOptions, instrument: UrdfOptions) -> SessionPlan:
        """Return what is drawn, of a camera and an instrument."""
        from dvrk_cmaes.camera.files import read_camera
        from dvrk_cmaes.frames.markers import read_marker_table
        from dvrk_cmaes.io.files import bundled_path
        from dvrk_cmaes.joints.lag import Lag
        from dvrk_cmaes.synth.levels import LEVELS
        from dvrk_cmaes.synth.moving_arm import FRAMES_A_SECOND
        from dvrk_cmaes.synth.session import SessionPlan, default_camera

        body = instrument.load()
        table = read_marker_table(bundled_path("markers", "lnd.json"))
        links = {body.instrument.root_link, *(joint.child for joint in body.instrument.chain.joints)}
        painted = all(marker.link in links for marker in table.values())
        level, given = LEVELS[self.level], camera.camera
        lens = None if given is None else read_camera(given, rectified=camera.rectified, side=camera.side)
        lag = None if self.lag is None else Lag.parse("--lag", self.lag).in_seconds(FRAMES_A_SECOND) * FRAMES_A_SECOND
        return SessionPlan(
            body=body,
            camera=lens or default_camera(level),
            level=level,
            motion=self.motion,
            frames=self.frames,
            seed=self.seed,
            markers=table if painted else {},
            arm=instrument.kinematics,
            lag=lag,
            cables="measured" if self.motion == "video" and self.level in ("medium", "hard") else "independent",
            baseline=_BASELINE if self.stereo else None,
            tool=_written(instrument),
            steered=self.ecm,
        )


def synth(
    out: Path,
    /,
    *,
    wanted: SynthOptions = SynthOptions(),
    overwrite: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    camera: CameraOptions = CameraOptions(),
    instrument: UrdfOptions = UrdfOptions(),
) -> int:
    """Write a synthetic session with known true poses, in the layout of a session folder.

    With --motion rcm an arm moves the instrument about its remote centre of motion: there are one camera_from_base and
    readings of the outer joints. With --motion free the poses of the frames are independent. Masks have simulated
    segmentation errors. Readings have errors like those of a robot: mostly one bias in the session, and in every frame
    they are nearer to the truth than to its mirror twin. Besides masks, images and readings the session has jaw tips
    (keypoints.csv), simulated detections of painted markers (markers.csv), the truth (golden.json) and all parameters
    (synth.json).

    With --motion video the frames are consecutive, 30 a second, of an arm that moves smoothly. Readings have offset,
    play and drift of each joint, at the levels medium and hard coupling, play and wander of a real arm's cables; a
    shadow is taken for the instrument for about a second at a time; images are late at the levels medium (1.5 frames)
    and hard (2.6), where another shaft and tissue pass before the instrument, too; at the level hard it leaves the view
    and comes back. Masks, images, readings and the truth are written. Images show
    the shadow on moving tissue that a mask takes for the instrument, and what passes before it; from easy to hard the
    tissue moves more, noise, motion blur and compression grow, and blood and smoke are added.

    Without --camera, the camera has 640 x 480 pixels and a focal length of 1026 px.

    Parameters of the levels (errors of the wrist's and the roll's readings in degrees, root mean square over many
    sessions; the jaw's error is 1.5 times the wrist's; at all levels yaw and pitch 0.1 deg, insertion 0.4 mm):

    - clean: wrist 5, roll 5; exact masks; markers 1.0 px.

    - easy: wrist 2, roll 2; correlated noise of the outline 0.4 px; markers 1.5 px.

    - medium: wrist 5, roll 5; correlated noise of the outline 0.9 px, logits in cells of 2 px, 3 lumps or bites of 2 to
      5 px, 2 missing highlights; tissue over a jaw in 20 % of the frames, always in ignore/; barrel distortion, and a
      circular field of view whose surroundings are in ignore/; markers 2.5 px.

    - hard: wrist 8, roll 8; correlated noise of the outline 1.5 px, logits in cells of 4 px, 6 lumps or bites of 3 to
      9 px, 4 missing highlights; tissue over a jaw in 70 % of the frames, in ignore/ for half of these; lens as medium;
      markers 4.0 px.

    Example:

    ```
    dvrk-cmaes synth sessions/hard --level hard --frames 20 --seed 3
    ```

    Parameters
    ----------
    out
        Session folder to write; it must be new or empty unless --overwrite is given.
    wanted
        What is drawn.
    overwrite
        Replace a synthetic session, unless a file in it was added or changed since.
    camera
        The camera.
    instrument
        The instrument.
    """
    wanted.check()
    from dvrk_cmaes.synth.recording import Pictures, write_recording
    from dvrk_cmaes.synth.session import write_session
    from dvrk_cmaes.synth.two_arms import write_two_arms
    from dvrk_cmaes.synth.two_arms_recording import write_recording_of_arms

    plan = wanted.plan(camera, instrument)
    pictures: Pictures = "none" if not wanted.images else "video" if wanted.mp4 else "files"
    if wanted.arms > 1 and wanted.motion == "video":
        write_recording_of_arms(out, plan, pictures=pictures, overwrite=overwrite)
    elif wanted.arms > 1:
        write_two_arms(out, plan, overwrite=overwrite)
    elif wanted.motion == "video":
        write_recording(out, plan, pictures=pictures, overwrite=overwrite)
    else:
        write_session(out, plan, images=wanted.images, overwrite=overwrite)
    drawn = f"{wanted.frames} frames, level {wanted.level}, motion {wanted.motion}, seed {wanted.seed}"
    show([Line(f"{drawn}; written: {out}")])
    return 0


def _written(instrument: UrdfOptions) -> ToolEntry:
    """Return the tool that is written to session.toml, with absolute paths."""
    tool = instrument.as_tool("PSM1")
    named = Path(tool.instrument or "lnd")
    return replace(
        tool,
        instrument=str(named.absolute() if named.is_file() else named),
        packages={name: folder.absolute() for name, folder in tool.packages.items()},
        tool=None if tool.tool is None else tool.tool.absolute(),
    )
