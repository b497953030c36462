"""The modules of scripts/pages: pages made for the site, and the check of its links."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from helpers.places import ROOT, SCRIPTS

import dvrk_cmaes
from dvrk_cmaes.io.video_writer import quiet_ffmpeg

pytestmark = pytest.mark.usefixtures("scripts_on_path")

HTML = {
    "index.html": '<h1 id="top">A</h1><a href="#top">1</a><a href="b/page.html#x">2</a><a href="https://a.b/c">3</a>',
    "b/page.html": '<a name="x"></a><img src="../picture.png"><link href="../a%20file.css"><a href="../">4</a>',
    "report.html": '<a href="#frame-0001">5</a><script>const frames = {"0001": 1}</script>',
}


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A site all of whose links lead somewhere."""
    for name, text in {**HTML, "picture.png": "", "a file.css": ""}.items():
        path = tmp_path / "site" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path / "site"


def test_links_that_lead_somewhere_are_not_named(site: Path) -> None:
    from pages.check_links import dead_links

    assert dead_links(site) == []


@pytest.mark.parametrize(
    ("page", "extra", "link"),
    [
        ("index.html", '<a href="b/other.html">', "b/other.html"),
        ("index.html", '<a href="#nowhere">', "#nowhere"),
        ("index.html", '<a href="b/page.html#nowhere">', "b/page.html#nowhere"),
        ("index.html", '<img src="missing.png">', "missing.png"),
        ("index.html", '<video poster="missing.jpg">', "missing.jpg"),
        ("index.html", '<svg><image xlink:href="missing.svg"/></svg>', "missing.svg"),
        ("b/page.html", '<a href="/index.html">', "/index.html"),  # holds at the root of a host alone
        ("b/page.html", '<a href="../../outside.html">', "../../outside.html"),
        ("b/page.html", '<script src="gone.js">', "gone.js"),
        ("report.html", '<a href="#frame-0002">', "#frame-0002"),
        ("index.html", '<a href="b/">', "b/"),  # a folder without a page
    ],
)
def test_a_link_that_leads_nowhere_is_named(site: Path, page: str, extra: str, link: str) -> None:
    from pages.check_links import dead_links

    (site.parent / "outside.html").write_text("")
    (site / page).write_text(HTML[page] + extra, encoding="utf-8")
    assert dead_links(site) == [f"{page}: {link}"]


def test_api_page_has_every_public_name_once() -> None:
    from pages.api_page import api_page

    page = api_page()
    entries = re.findall(r"^::: dvrk_cmaes\.(\w+)$", page, flags=re.MULTILINE)
    assert sorted([*entries, "__version__"]) == sorted(dvrk_cmaes.__all__)
    kinds = {part.split("\n")[0]: re.findall(r"::: dvrk_cmaes\.(\w+)", part) for part in page.split("\n## ")[1:]}
    assert list(kinds) == ["Functions", "Classes", "Settings", "Errors"]
    assert "estimate" in kinds["Functions"]
    assert "Camera" in kinds["Classes"]
    assert kinds["Settings"] == ["EstimateConfig"]
    assert kinds["Errors"] == ["DvrkCmaesError", "InputError"]


def test_example_page_has_sentence_and_text_of_each_script() -> None:
    from pages.example_page import example_page

    page = example_page(SCRIPTS / "examples")
    paths = sorted((SCRIPTS / "examples").glob("*.py"))
    assert re.findall(r"^## (.+)$", page, flags=re.MULTILINE) == [
        "Calibrate session",
        "Estimate frame",
        "Follow recording",
        "Live launch",
        "Sam2 mask node",
        "Two tools",
    ]
    assert all(path.read_text(encoding="utf-8") in page for path in paths)


def test_gallery_shows_what_its_commands_wrote(tmp_path: Path) -> None:
    from pages.gallery import Exhibit, gallery_page

    shown = Exhibit(
        "One",
        "A text.",
        ("estimate --mask data/demo/masks/0001.png --camera data/demo/camera.yaml --joints jaw=0.8 --out frame",),
        "frame",
        (("overlays/0001.jpg", "a picture"),),
        (("frames/0001.json", "a result"),),
    )
    out, work = tmp_path / "gallery", tmp_path / "work"
    work.mkdir()
    page = gallery_page(out, work, [shown])
    assert (out / "frame" / "overlays" / "0001.jpg").is_file()
    assert "## One\n\nA text.\n" in page
    assert "![a picture](gallery/frame/overlays/0001.jpg)" in page
    assert "[Open a result](gallery/frame/frames/0001.json){ .md-button }" in page
    printed = page.replace("\\\n", " ").splitlines()
    assert [" ".join(line.split()) for line in printed if line.startswith("    dvrk-cmaes ")] == [
        f"dvrk-cmaes {shown.commands[0]}"
    ]
    assert max(len(line) for line in page.splitlines() if line.startswith("    ")) <= 100


def test_gallery_stops_at_a_command_that_fails(tmp_path: Path) -> None:
    from pages.gallery import Exhibit, gallery_page

    work = tmp_path / "work"
    work.mkdir()
    wrong = Exhibit("One", "A text.", ("batch missing --out x",), "x", ())
    with pytest.raises(RuntimeError, match="exit code 2\ndvrk-cmaes: missing: "):
        gallery_page(tmp_path / "gallery", work, [wrong])


def test_every_exhibit_shows_files_that_its_last_command_writes() -> None:
    from pages.gallery import EXHIBITS

    for exhibit in EXHIBITS:
        assert exhibit.commands[-1].endswith(f"--out {exhibit.shown}")
        assert exhibit.pictures or exhibit.pages


def test_moving_picture_has_every_frame_with_its_status(tmp_path: Path) -> None:
    from pages.moving_picture import moving_picture

    quiet_ffmpeg()
    code = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(tmp_path / "tracks.mp4"), cv2.CAP_FFMPEG, code, 10.0, (320, 240))
    for grey in (60, 120, 180):
        writer.write(np.full((240, 320, 3), grey, np.uint8))
    writer.release()
    said = [("ok", []), ("doubtful", ["hidden: 40 %"]), ("lost", ["no edges"])]
    lines = [json.dumps({"status": status, "reasons": reasons}) for status, reasons in said]
    (tmp_path / "tracks.jsonl").write_text("\n".join(lines) + "\n")
    data = moving_picture(tmp_path, width=160, milliseconds=70, quality=90)
    read, animation = cv2.imdecodeanimation(np.frombuffer(data, np.uint8))
    assert read
    assert list(animation.durations) == [70, 70, 70]
    frames = [np.asarray(frame)[:, :, :3] for frame in animation.frames]
    assert [frame.shape for frame in frames] == [(120, 160, 3)] * 3
    assert [round(float(frame[60:].mean()), -1) for frame in frames] == [60, 120, 180]
    strips = [frame[:20].reshape(-1, 3).max(axis=0) for frame in frames]  # BGR: green, yellow, red
    assert strips[0][1] > strips[0][2]
    assert min(strips[1][1:]) > strips[1][0]
    assert strips[2][2] > strips[2][1]


def test_navigation_has_every_page_of_the_reference() -> None:
    text = (SCRIPTS / "pages" / "mkdocs.yml").read_text(encoding="utf-8")
    pages = set(re.findall(r"data/reference/\w+\.md", text))
    assert pages == {str(path.relative_to(ROOT)) for path in (ROOT / "data" / "reference").glob("*.md")}
    assert re.search(r"^strict: true$", text, flags=re.MULTILINE)


def test_documentation_is_built_and_published_with_least_permissions() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/docs.yml").read_text(encoding="utf-8"))
    jobs = workflow["jobs"]
    assert workflow["permissions"] == {}
    assert {name: job["permissions"] for name, job in jobs.items()} == {
        "build": {"contents": "read"},
        "publish": {"pages": "write", "id-token": "write"},
    }
    assert jobs["publish"]["needs"] == "build"
    assert "make site PYTHON=python" in [step.get("run") for step in jobs["build"]["steps"]]
