"""The experiments run, write what they say, and judge their own figures; what they simulate is what they state."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from dvrk_cmaes.geometry import moved
from dvrk_cmaes.silhouette import Body

EXPERIMENTS = Path(__file__).resolve().parents[1] / "scripts" / "experiments"

if TYPE_CHECKING:
    from experiment import Options
    from picking import Gripper, Start


@pytest.fixture(autouse=True)
def experiments_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXPERIMENTS))


@pytest.fixture
def options(tmp_path: Path) -> Options:
    from experiment import Options

    return Options(out=tmp_path, quick=True, shared=tmp_path / "nowhere", seed=0)


def written(folder: Path, name: str) -> dict[str, Any]:
    """An experiment's JSON; its table and picture must be there, too."""
    document: dict[str, Any] = json.loads((folder / f"{name}.json").read_text())
    text = (folder / f"{name}.md").read_text()
    assert text.startswith(f"# {document['title']}\n\nA quick run, too small to conclude anything from. ")
    assert f"![{document['title']}]({name}.png)" in text
    assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert set(document["ran"]) == {"date", "commit", "machine", "version", "quick", "seed", "minutes"}
    for claim in document["claims"]:
        assert f"- {'Holds' if claim['holds'] else '**Does not hold**'}: {claim['text']} (" in text
    return document


# each runs


def test_table_one_compares_our_axes_with_those_of_three_baselines(
    options: Options, monkeypatch: pytest.MonkeyPatch
) -> None:
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


@pytest.mark.shared
def test_table_one_has_the_authors_figures_to_the_digit(shared: Path) -> None:
    import table1

    rows = table1.real_rows(shared, 0)
    claims = table1.claims_of(rows)
    assert [(claim.holds, claim.figures) for claim in claims] == [(True, "easy 0.00046 m, medium 0.00243 m")]


def test_figure_four_finds_better_candidates_where_the_shaft_s_edges_are(options: Options) -> None:
    import figure4

    figure4.run(options, figure4.Size(frames=2, draws=1))
    document = written(options.out, "figure4")
    median = {space: found[1] for space, found in document["loss_percentiles_25_50_75"].items()}
    assert all(a >= b for curve in median.values() for a, b in pairwise(curve))
    assert median["LookAt with shaft edges"][-1] < median["uniform 6-D"][-1]


def test_table_two_says_that_it_is_a_simulation(options: Options) -> None:
    import table2

    table2.run(options, table2.Size(trials=2, frames=2))
    document = written(options.out, "table2")
    assert len(document["rows"]) == 18
    assert all(row["trials"] == 2 for row in document["rows"])
    assert "simulated" in document["title"]
    assert "**A simulation, not a robot.**" in (options.out / "table2.md").read_text()


def test_the_ablation_leaves_out_or_exchanges_one_part_at_a_time(
    options: Options, monkeypatch: pytest.MonkeyPatch
) -> None:
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


# what is judged


def test_a_claim_that_fails_is_written_as_failing() -> None:
    import table1

    rows = [
        {"frames": "made, hard", "method": "ours", "sigma_m": 0.002},
        {"frames": "made, hard", "method": "PnP, SQPNP", "sigma_m": 0.005},
        {"frames": "made, hard", "method": "PnP, RANSAC", "sigma_m": 0.004},
    ]
    (claim,) = table1.claims_of(rows)
    assert (claim.holds, claim.figures) == (False, "0.50 of the better PnP's 0.00400 m")


def test_an_order_of_medians_is_told_from_quartiles_that_do_not_overlap() -> None:
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
def test_intervals_are_wilson_s(won: int, trials: int, low: float, high: float) -> None:
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


def test_the_lost_share_follows_from_published_errors_alone() -> None:
    from picking import STRETCH

    assert pytest.approx(np.sqrt((12**2 + 16**2) / 2) * np.sqrt(3) / 80) == STRETCH


def test_without_stretch_noise_or_bias_the_jaws_come_where_they_should(gripper: Gripper, start: Start) -> None:
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
def test_jaws_pick_what_they_close_on(
    gripper: Gripper, x: float, y: float, z: float, needle: bool, gauze: bool
) -> None:
    from picking import OPENING, picks_gauze, picks_needle

    goal = moved(np.eye(4), np.array([0.01, -0.02, 0.1, 0.3, -0.5, 0.8]))
    jaws = moved(goal, 1e-3 * np.array([x, y, z, 0, 0, 0]))
    assert picks_needle(gripper, jaws, OPENING, goal) == needle
    assert picks_gauze(gripper, jaws, OPENING, goal) == gauze


# the README's table


def test_claims_go_between_the_marked_lines_of_a_readme(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from readme_table import BEGIN, END, ORDER, main

    readme = tmp_path / "README.md"
    readme.write_text(f"# x\n{BEGIN}\nold\n{END}\nrest\n")
    line = ["--results", str(tmp_path), "--readme", str(readme)]
    ran = {"date": "2026-11-21", "commit": "abc", "machine": "m", "quick": False, "minutes": 3.0}
    assert main(line) == 2
    assert "table1.json: no such file" in capsys.readouterr().err
    for name in ORDER:
        claim = {"text": f"{name} is good", "holds": name != "table2", "figures": "1 of 2"}
        document = {"title": f"{name}: so", "ran": ran, "claims": [claim]}
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
    assert main(line) == 0
    text = readme.read_text()
    assert "| [table2](./table2.md) | table2 is good | **no** | 1 of 2 |" in text
    assert "\nold\n" not in text
    assert text.endswith(f"{END}\nrest\n")
    (tmp_path / "table1.json").write_text(json.dumps({**document, "ran": {**ran, "quick": True}}))
    assert main(line) == 2
    assert "expected a full run, got a quick one" in capsys.readouterr().err
    readme.write_text("# x\n")
    (tmp_path / "table1.json").write_text(json.dumps(document))
    assert main(line) == 2
    assert readme.read_text() == "# x\n"


def test_scripts_are_found_by_the_names_that_make_uses() -> None:
    makefile = (EXPERIMENTS.parents[1] / "Makefile").read_text()
    named = [word for word in makefile.split() if word.startswith("scripts/experiments/")]
    assert len(named) == 5
    assert all((EXPERIMENTS.parents[1] / name).exists() for name in named)
