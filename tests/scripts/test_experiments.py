"""The experiments: they run, write their results, and evaluate their claims; the simulation follows its description."""

from __future__ import annotations

import json
import shutil
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from helpers.places import ROOT, SCRIPTS

from dvrk_cmaes.geometry import moved
from dvrk_cmaes.silhouette import Body

EXPERIMENTS = SCRIPTS / "experiments"

if TYPE_CHECKING:
    from experiment import Options
    from picking import Gripper, Start


@pytest.fixture(autouse=True)
def experiments_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXPERIMENTS))


@pytest.fixture
def options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Options:
    """A quick run, with images of half the usual size."""
    import made_sessions
    from experiment import Options

    camera = made_sessions.default_camera
    monkeypatch.setattr(made_sessions, "default_camera", lambda level: camera(level).scaled(320, 240))

    return Options(out=tmp_path, quick=True, shared=tmp_path / "nowhere", seed=0)


def written(folder: Path, name: str) -> dict[str, Any]:
    """Give an experiment's JSON, after checking that its table and picture exist."""
    document: dict[str, Any] = json.loads((folder / f"{name}.json").read_text())
    text = (folder / f"{name}.md").read_text()
    assert text.startswith(f"# {document['title']}\n\nA quick run, too small to conclude anything from. ")
    assert f"![{document['title']}]({name}.png)" in text
    assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert set(document["ran"]) == {"date", "commit", "machine", "version", "quick", "seed", "minutes"}
    for claim in document["claims"]:
        assert f"- {'Holds' if claim['holds'] else '**Does not hold**'}: {claim['text']} (" in text
    return document


# every experiment runs


def test_table_1_compares_with_three_baselines(options: Options, monkeypatch: pytest.MonkeyPatch) -> None:
    import table1

    monkeypatch.setattr(table1, "LEVELS", ("easy",))
    table1.run(options, table1.Size(sessions=1, frames=3, real=None))
    document = written(options.out, "table1")
    sigma = {row["method"]: row["sigma_m"] for row in document["rows"]}
    assert list(sigma) == ["ours", "PnP, SQPNP", "PnP, RANSAC", "tips and shaft edges"]
    assert sigma["ours"] < 0.001
    assert [claim["text"] for claim in document["claims"]] == [
        "easy: our sigma is a fifth of PnP's from painted markers, or less"
    ]


def test_table_1_reproduces_published_figures(shared: Path) -> None:
    import table1

    rows = table1.real_rows(shared, 0)
    claims = table1.claims_of(rows)
    assert [(claim.holds, claim.figures) for claim in claims] == [(True, "easy 0.00046 m, medium 0.00243 m")]
    late, in_time = (row for row in rows if row["frames"].startswith("real, medium"))
    assert (late["sigma_m"], in_time["frames"]) == (in_time["sigma_m"], "real, medium, readings in time")
    assert in_time["base_rotation_deg_median"] < 0.6 * late["base_rotation_deg_median"]


def test_figure_4_finds_better_candidates_on_shaft_axis(options: Options, monkeypatch: pytest.MonkeyPatch) -> None:
    import figure4

    monkeypatch.setattr(figure4, "COUNTS", (25, 50, 100, 200, 300))
    figure4.run(options, figure4.Size(frames=2, draws=1))
    document = written(options.out, "figure4")
    median = {space: found[1] for space, found in document["loss_percentiles_25_50_75"].items()}
    assert all(a >= b for curve in median.values() for a, b in pairwise(curve))
    assert median["LookAt with shaft edges"][-1] < median["uniform 6-D"][-1]


def test_table_2_is_marked_as_simulation(options: Options) -> None:
    import table2

    table2.run(options, table2.Size(trials=2, frames=2))
    document = written(options.out, "table2")
    assert len(document["rows"]) == 18
    assert all(row["trials"] == 2 for row in document["rows"])
    assert "simulated" in document["title"]
    assert "**A simulation, not a robot.**" in (options.out / "table2.md").read_text()


def test_ablation_changes_one_part_at_a_time(options: Options, monkeypatch: pytest.MonkeyPatch) -> None:
    import ablation

    from dvrk_cmaes.config import EstimateConfig

    names = [variant.name for variant in ablation.variants(EstimateConfig())]
    assert len(names) == len(set(names))
    assert {"loss: no cylinder", "seeds: shaft edges not used", "search: crs2", "refinement: bobyqa"} < set(names)
    monkeypatch.setattr(ablation, "LEVELS", ("medium",))
    ablation.run(options, ablation.Size(frames=1, variants=2))
    document = written(options.out, "ablation")
    assert [(row["variant"], row["level"]) for row in document["rows"]] == [
        ("as it is", "medium"),
        ("loss: no mse", "medium"),
    ]
    assert document["rows"][0]["right_mode"] == 1


# claims


def test_failed_claim_is_reported() -> None:
    import table1

    rows = [
        {"frames": "made, hard", "method": "ours", "sigma_m": 0.002},
        {"frames": "made, hard", "method": "PnP, SQPNP", "sigma_m": 0.005},
        {"frames": "made, hard", "method": "PnP, RANSAC", "sigma_m": 0.004},
    ]
    (claim,) = table1.claims_of(rows)
    assert (claim.holds, claim.figures) == (False, "0.50 of the better PnP's 0.00400 m")


def test_order_of_medians_requires_separate_quartiles() -> None:
    import figure4

    rng = np.random.default_rng(0)
    wide = {
        space: level + rng.uniform(-1, 1, (40, len(figure4.COUNTS)))
        for space, level in zip(figure4.SPACES, (3.0, 9.0, 2.6, 0.5), strict=True)
    }
    holds = [claim.holds for claim in figure4.claims_of(wide)]
    assert holds == [True, True, True, False]


@pytest.mark.parametrize(
    ("won", "trials", "low", "high"), [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (200, 200, 0.9812, 1.0)]
)
def test_intervals_are_wilson_intervals(won: int, trials: int, low: float, high: float) -> None:
    from experiment import wilson

    assert wilson(won, trials) == pytest.approx((low, high), abs=1e-4)


# the simulated arm


@pytest.fixture
def gripper(bundled_body: Body) -> Gripper:
    from picking import Gripper

    return Gripper(bundled_body.instrument)


@pytest.fixture
def start(bundled_body: Body) -> Start:
    from made_sessions import make
    from table2 import start_of

    made = make(bundled_body, "medium", 1, 3)
    return start_of(made, made.frames[0])


def test_stretch_follows_from_published_errors() -> None:
    from picking import STRETCH

    assert pytest.approx(np.sqrt((12**2 + 16**2) / 2) * np.sqrt(3) / 80) == STRETCH


def test_jaws_reach_goal_without_errors(gripper: Gripper, start: Start) -> None:
    from picking import Calibration, Start, camera_from_jaws, command, moved_truth, picks_gauze, picks_needle
    from table2 import reachable_goal

    goal = reachable_goal(gripper, start, 0.035, np.random.default_rng(0))
    perfect = Start(start.camera_from_base, start.true, start.true)
    calibration = Calibration(start.camera_from_base, {})
    read = command(gripper, calibration, perfect, goal)
    assert read is not None
    none = dict.fromkeys(("yaw", "pitch", "insertion"), 0.0)
    true = moved_truth(perfect, read, none, stretch=0.0)
    jaws = camera_from_jaws(gripper, start.camera_from_base, true)
    np.testing.assert_allclose(jaws, goal, atol=2e-4)
    assert picks_needle(gripper, jaws, true["jaw"], goal)
    assert picks_gauze(gripper, jaws, true["jaw"], goal)
    stretched = moved_truth(perfect, read, none, stretch=0.3)
    lost = {name: true[name] - stretched[name] for name in true}
    assert lost["wrist_pitch"] == pytest.approx(0.3 * (read["wrist_pitch"] - perfect.read["wrist_pitch"]))
    assert lost["insertion"] == 0


@pytest.mark.parametrize(
    ("x", "y", "z", "needle", "gauze"),
    [
        (0, 0, 0, True, True),
        (3.5, 0, 0, False, True),  # the needle is beside the jaws
        (2.0, 0, 0, True, True),
        (0, -2.7, 0, True, True),
        (0, -4.5, 0, False, False),  # the jaws stop short of both
        (0, 3.9, 0, False, True),  # the needle is at the hinge
        (0, 7.0, 0, False, False),  # the hinge is in the gauze
        (0, 0, 6.0, True, True),  # along the needle
        (0, 0, 39.0, False, False),  # beyond the gauze's side
    ],
)
def test_picking_depends_on_position_of_jaws(
    gripper: Gripper, x: float, y: float, z: float, needle: bool, gauze: bool
) -> None:
    from picking import OPENING, picks_gauze, picks_needle

    goal = moved(np.eye(4), np.array([0.01, -0.02, 0.1, 0.3, -0.5, 0.8]))
    jaws = moved(goal, 1e-3 * np.array([x, y, z, 0, 0, 0]))
    assert picks_needle(gripper, jaws, OPENING, goal) == needle
    assert picks_gauze(gripper, jaws, OPENING, goal) == gauze


# the table of claims


def test_claims_are_written_between_marked_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from readme_table import BEGIN, END, ORDER, main

    page = tmp_path / "reference" / "experiments.md"
    page.parent.mkdir()
    page.write_text(f"# x\n{BEGIN}\nold\n{END}\nrest\n")
    line = ["--results", str(tmp_path), "--page", str(page)]
    ran = {"date": "2026-11-21", "commit": "abc", "machine": "m", "quick": False, "minutes": 3.0}
    assert main(line) == 2
    assert "table1.json: no such file" in capsys.readouterr().err
    for name in ORDER:
        claim = {"text": f"{name} is good", "holds": name != "table2", "figures": "1 of 2"}
        document = {"title": f"{name}: so", "ran": ran, "claims": [claim]}
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
    assert main(line) == 0
    text = page.read_text()
    assert "| [table2](../table2.md) | table2 is good | **no** | 1 of 2 |" in text
    assert "\nold\n" not in text
    assert text.endswith(f"{END}\nrest\n")
    (tmp_path / "table1.json").write_text(json.dumps({**document, "ran": {**ran, "quick": True}}))
    assert main(line) == 2
    assert "expected a full run, got a quick one" in capsys.readouterr().err
    page.write_text("# x\n")
    (tmp_path / "table1.json").write_text(json.dumps(document))
    assert main(line) == 2
    assert page.read_text() == "# x\n"


def test_bundled_page_has_claims_of_bundled_experiments(tmp_path: Path) -> None:
    from readme_table import PAGE, main

    copy = tmp_path / "data" / "reference" / "experiments.md"
    shutil.copytree(PAGE.parents[1] / "experiments", tmp_path / "data" / "experiments")
    copy.parent.mkdir()
    shutil.copy(PAGE, copy)
    assert main(["--results", str(tmp_path / "data" / "experiments"), "--page", str(copy)]) == 0
    assert copy.read_text() == PAGE.read_text()


def test_scripts_named_in_makefile_exist() -> None:
    makefile = (ROOT / "Makefile").read_text()
    named = [word for word in makefile.split() if word.startswith("scripts/experiments/")]
    assert len(named) == 5
    assert all((ROOT / name).exists() for name in named)
