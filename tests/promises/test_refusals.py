"""Bad input: one line that names the file, the field and what was expected, exit code 2, and nothing written."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvrk_cmaes import Camera, InputError, estimate, read_camera
from promises.program import CAMERA, DEMO, ROOT, content, run

FRAME = {
    "--mask": DEMO / "masks" / "0001.png",
    "--camera": DEMO / "camera.yaml",
    "--joints": DEMO / "joints.csv",
    "--out": "out",
}
READINGS = "frame,wrist_pitch,wrist_yaw,jaw\n0001,0.1,0.2,0.3\n"
URDF = (ROOT / "data" / "instruments" / "lnd" / "lnd.urdf").read_text()


def estimate_with(**options: object) -> list[object]:
    """Give the words of an estimate of a bundled frame, some options with other values."""
    given = FRAME | {f"--{name.replace('_', '-')}": value for name, value in options.items()}
    return ["estimate", *(word for pair in given.items() for word in pair)]


def camera(**fields: str) -> str:
    """Give the text of a camera file, some fields with other values."""
    text = CAMERA.replace("320", "640").replace("240", "480")
    for name, value in fields.items():
        text = re.sub(rf"^{name}: .*$", f"{name}: {value}", text, flags=re.MULTILINE)
    return text


def of_numbers(*numbers: object) -> str:
    """Give the text of a camera file with these numbers as its matrix."""
    return camera(camera_matrix=f"{{rows: 3, cols: 3, data: [{', '.join(map(str, numbers))}]}}")


FILES: dict[str, tuple[str, str | bytes, str]] = {
    # the option by which the file `bad` is given, what is written to it, what the line says
    "camera, no YAML": ("camera", "a: [1", r"bad: .*expected"),
    "camera, empty": ("camera", "", r"bad: expected"),
    "camera, of nothing known": ("camera", "a: 1\n", r"bad: .*expected.*camera"),
    "camera, size": ("camera", camera(image_width="-3"), r"bad: image_width: expected .*-3"),
    "camera, matrix": ("camera", of_numbers(1, 2), r"bad: camera_matrix.*expected 9 .*got 2"),
    "camera, not a number": ("camera", of_numbers(".nan", 0, 1, 0, 5, 1, 0, 0, 1), r"bad: camera_matrix.*expected"),
    "camera, focal length": ("camera", of_numbers(0, 0, 1, 0, 5, 1, 0, 0, 1), r"bad: .*(fx|focal|camera_matrix)"),
    "camera, lens": ("camera", camera(distortion_model="of glass"), r"bad: distortion_model: .*'of glass'"),
    "camera, other aspect": ("camera", CAMERA.replace("240", "200"), r".*0001\.png: mask: expected .*320 x 200"),
    "readings, text": ("joints", READINGS.replace("0.2", "ten"), r"bad.*wrist_yaw: expected .*'ten'"),
    "readings, degrees": ("joints", READINGS.replace("0.2", "30"), r"bad.*wrist_yaw: expected radians"),
    "readings, unknown joint": ("joints", "frame,elbow\n0001,0.1\n", r"bad: .*expected"),
    "readings, twice": ("joints", READINGS + "0001,0.1,0.2,0.3\n", r"bad.*0001"),
    "readings, other frames": ("joints", "frame,jaw\na,0.3\nb,0.3\n", r"bad: .*0001"),
    "readings, ragged": ("joints", READINGS + "0002,0.1\n", r"bad: .*expected 4"),
    "mask, no picture": ("mask", "text", r"bad: expected a mask \(PNG or JPEG\)"),
    "mask, torn": ("mask", (DEMO / "masks" / "0001.png").read_bytes()[:300], r"bad: expected a mask .*damaged"),
    "ignore, no picture": ("ignore", "text", r"bad: expected a mask of ignored pixels"),
    "image, no picture": ("image", "text", r"bad: expected an image"),
    "settings, unknown": ("config", "seeed = 3\n", r"bad: unknown key seeed; the nearest known is seed"),
    "settings, type": ("config", "seed = 'a'\n", r"bad: seed: expected .*'?a'?"),
    "settings, range": ("config", "[search]\nsamples = -1\n", r"bad: search\.samples: expected .*-1"),
    "settings, no TOML": ("config", "seed = \n", r"bad: .*(TOML|line 1)"),
    "instrument, no XML": ("instrument", "<robot", r"bad\.urdf: .*XML"),
    "instrument, mesh": ("instrument", URDF.replace('filename="', 'filename="none/'), r"bad\.urdf.*no such file"),
    "instrument, root": ("instrument", URDF, r".*elbow"),
    "session, no JSON": ("session", "{", r"bad: .*(JSON|expected)"),
    "session, schema": ("session", '{"schema": 99}', r"bad: schema: expected .*99"),
    "session, field": ("session", '{"schema": 2, "camera_from_base": [[1, 2]], "frames": []}', r"bad: .*expected"),
    "tool, no JSON": ("tool", "{", r"bad: .*expected|bad: .*JSON"),
}

WORDS: dict[str, tuple[list[object], str]] = {
    "no such command": (["guess"], r".*guess"),
    "no such option": (estimate_with(jont="a"), r".*--jont.*[Dd]id you mean --joints\?"),
    "option without value": (["estimate", "--mask"], r".*--mask requires an argument"),
    "required option": (["estimate", "--mask", "a.png"], r"--camera: expected a camera file, got none"),
    "required argument": (["export", "--to", "tf"], r"RESULTS: missing; it is required"),
    "no such file": (estimate_with(mask="nothere.png"), r"nothere\.png: no such file"),
    "no such session": (["batch", "nothere"], r"nothere: no such folder; expected a session"),
    "no such frame": (["batch", DEMO, "--out", "out", "--frames", "0009"], r".*0009"),
    "file as a session": (["batch", DEMO / "joints.csv", "--out", "out"], r".*joints\.csv: .*expected"),
    "folder as a mask": (estimate_with(mask=DEMO), r".*demo: expected .*folder|.*demo: .*"),
    "choice": (estimate_with(arm="old"), r".*old.*classic.*si|.*classic.*si.*old"),
    "number": (estimate_with(seed="many"), r".*--seed.*many"),
    "fraction": (estimate_with(seed="1.5"), r"--seed: expected a whole number, got '1\.5'"),
    "range": (estimate_with(seed="-1"), r"--seed.*-1"),
    "threads": (estimate_with(threads="0"), r"--threads.*0"),
    "unknown joint": (estimate_with(joints="elbow=1"), r".*joints: .*elbow"),
    "degrees": (estimate_with(joints="wrist_yaw=40"), r".*joints: .*wrist_yaw: expected radians .*degrees"),
    "keypoints": (estimate_with(keypoints="1,2,3"), r".*keypoints: expected four numbers"),
    "time": (estimate_with(time="noon"), r"--time: .*expected a finite number of seconds, got 'noon'"),
    "label": (estimate_with(label="9"), r".*0001\.png: .*label 9|.*label.*9"),
    "package path": (estimate_with(package_path="a"), r"--package-path: expected NAME=DIR"),
    "no results": (["export", DEMO / "masks", "--to", "csv", "--out", "out"], r".*masks: expected"),
    "no place": (["batch", DEMO, "--out", "/proc/none"], r"/proc/none: not written \(No such file"),
    "inspect": (["inspect", "nothere"], r"nothere: no such"),
    "import": (["import", "nothere.bag", "--out", "out"], r"nothere\.bag: no such file; expected a ROS recording"),
    "synth": (["synth", "out", "--frames", "0"], r"--frames: .*1 to 100000|.*frames.*0"),
    "track": (["track", DEMO, "--out", "out", "--lag", "soon"], r"--lag: .*'?soon"),
    "track, every": (["track", DEMO, "--every", "0"], r"--every: expected a whole number of at least 1, got 0"),
    "track, workers": (["track", DEMO, "--workers", "0"], r"--workers: expected a whole number of at least 1, got 0"),
    "track, frames": (["track", DEMO, "--frames", "00*"], r"--frames: no option here; use --every"),
    "track, fps": (
        ["track", DEMO, "--fps", "0"],
        r"--fps: no option here; use track\.frames_a_second in the settings file",
    ),
    "track, session": (["track", DEMO, "--out", "out", "--session", "none.json"], r"none\.json: no such file"),
    "track, rerun": (["track", DEMO, "--rerun", "a.mp4"], r"--rerun: expected .* that ends in \.rrd, got 'a\.mp4'"),
    "calibrate": (["calibrate", DEMO, "--out", "out", "--keyframes", "0"], r"--keyframes.*0"),
    "live": (["live", "--seconds", "-1"], r".*seconds.*-1"),
    "help": (["help", "cooking"], r".*cooking"),
    "compare": (["compare", "nothere", DEMO / "golden.json"], r"nothere: no such"),
    "segment": (["segment", "nothere.png", "--out", "out"], r"nothere\.png: no such"),
    "pnp": (["pnp", DEMO, "--out", "out"], r".*(markers\.csv|keypoints\.csv)"),
}


@pytest.mark.parametrize("kind", FILES)
def test_file_is_refused_by_its_name_and_field(tmp_path: Path, kind: str) -> None:
    option, written, expected = FILES[kind]
    path = tmp_path / ("bad.urdf" if option == "instrument" else "bad")
    path.write_bytes(written if isinstance(written, bytes) else written.encode())
    more = {"mask": {"frame": "0001"}, "instrument": {"root_link": "elbow"} if "root" in kind else {}}
    before = content(tmp_path)
    refusal = run(*estimate_with(**{option: path.name}, **more.get(option, {})), folder=tmp_path).refusal
    assert re.match(expected, refusal), refusal
    assert len(refusal) < 600
    assert content(tmp_path) == before


@pytest.mark.parametrize("kind", WORDS)
def test_command_line_is_refused_by_what_is_wrong_with_it(tmp_path: Path, kind: str) -> None:
    words, expected = WORDS[kind]
    refusal = run(*words, folder=tmp_path).refusal
    assert re.match(expected, refusal), refusal
    assert list(tmp_path.iterdir()) == []


def _linked_outside(session: Path) -> None:
    (session / "images" / "0001.jpg").unlink()
    (session / "images" / "0001.jpg").symlink_to(DEMO / "images" / "0002.jpg")


def _written(name: str, text: str) -> Callable[[Path], object]:
    return lambda session: (session / name).write_text(text)


TABLE = (DEMO / "joints.csv").read_text()
SESSIONS: dict[str, tuple[Callable[[Path], object], str]] = {
    "rows of other frames": (_written("joints.csv", TABLE.replace("\n0", "\n9")), r".*joints\.csv: .*frame"),
    "no camera": (lambda session: (session / "camera.yaml").unlink(), r".*camera"),
    "no masks": (lambda session: [shutil.rmtree(session / name) for name in ("masks", "images")], r".*(masks|images)"),
    "truth": (
        _written("golden.json", '{"frames": {"0001": {"T_camera_roll_link": [1]}}}'),
        r".*golden\.json: .*T_camera_roll_link",
    ),
    "session.toml": (
        _written("session.toml", '[[tool]]\narm = "PSM1"\nlable = 3\n'),
        r".*session\.toml: .*lable.*label",
    ),
    "link that leads out": (_linked_outside, r".*0001\.jpg.*link|.*link.*0001\.jpg"),
}


@pytest.mark.parametrize("command", ["batch", "track"])
@pytest.mark.parametrize("kind", SESSIONS)
def test_session_is_refused_by_what_is_wrong_in_it(tmp_path: Path, kind: str, command: str) -> None:
    session = tmp_path / "session"
    shutil.copytree(DEMO, session)
    change, expected = SESSIONS[kind]
    change(session)
    before = content(session)
    refusal = run(command, session, "--out", tmp_path / "out").refusal
    assert re.match(expected, refusal), refusal
    assert content(session) == before
    assert not (tmp_path / "out").exists()


def test_mask_that_cannot_be_one_is_refused() -> None:
    small, mask = Camera(320, 240, 521.3, 519.0, 163.0, 117.5), np.zeros((240, 320), np.bool_)
    for given, expected in ((mask, "some instrument"), (~mask, "some background"), (mask[:9], "320 x 240 pixels")):
        with pytest.raises(InputError, match=f"^mask: .*{expected}"):
            estimate(given, small, {})


def test_readers_in_python_refuse_with_the_same_line_as_commands(tmp_path: Path) -> None:
    (tmp_path / "camera.yaml").write_text(camera(image_width="-3"))
    with pytest.raises(InputError) as caught:
        read_camera(tmp_path / "camera.yaml")
    assert run(*estimate_with(camera=tmp_path / "camera.yaml"), folder=tmp_path).refusal == str(caught.value)


def test_inspect_names_what_it_cannot_read_and_reads_the_rest(tmp_path: Path) -> None:
    (tmp_path / "bad.json").write_text("{")
    ran = run("inspect", tmp_path / "bad.json", DEMO / "camera.yaml", "--json")
    bad, good = ran.document
    assert ran.code == 2
    assert bad["error"] in ran.err
    assert good["kind"] == "camera"


def test_image_of_many_pixels_is_refused_unread(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "huge.png"), np.zeros((6001, 6000), np.uint8))
    refusal = run(*estimate_with(mask=tmp_path / "huge.png", frame="0001"), folder=tmp_path).refusal
    assert "expected at most 36 megapixels, got 6000 x 6001" in refusal


def test_document_of_many_digits_or_levels_is_refused(tmp_path: Path) -> None:
    for text in ("[" * 100_000, '{"schema": ' + "9" * 5000 + "}", json.dumps({"schema": 1e308})):
        (tmp_path / "session.json").write_text(text)
        refusal = run(*estimate_with(session=tmp_path / "session.json"), folder=tmp_path).refusal
        assert refusal.startswith(f"{tmp_path / 'session.json'}: ")
        assert len(refusal) < 600
