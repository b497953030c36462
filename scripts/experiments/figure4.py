"""The paper's Figure 4: loss of the best of N candidates, by the space from which they are drawn.

In each synthetic frame of the level medium, candidates are drawn in four ways: uniformly in six dimensions; from the
LookAt space of the paper, with the root on the optical axis; from our LookAt space, which is rotated towards the mask;
and as in our search, most of them from the axis given by the shaft's edges. The joints are drawn around the readings in
the same way. All candidates are scored by the loss of the search without its readings term. A search would start from
the best of the first N candidates.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from measuring.report import markdown
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig, LookAtRange
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.geometry import Posed, exp_rotation, transform
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.global_search import search_size
from dvrk_cmaes.pose.search.objective import Objective
from dvrk_cmaes.pose.search.starts import draw_starts, sample_joints, sample_lookat
from dvrk_cmaes.silhouette import Renderer
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.session import SyntheticFrame
from experiments.made_sessions import Made, make
from experiments.parts import Claim, Options, new_figure, progress, write_experiment

Float64 = NDArray[np.float64]

UNIFORM, CENTRED, LOOKAT, EDGES = "uniform 6-D", "LookAt, on the optical axis", "LookAt", "LookAt with shaft edges"
SPACES: Final = (UNIFORM, CENTRED, LOOKAT, EDGES)
LIMITS: Final = LookAtRange(near=0.05, far=0.22)
"""Of the candidates without knowledge of the image; their distances are uniform, as in the paper."""
COUNTS: Final = (25, 50, 100, 200, 300, 500, 700, 1000)
FULL, QUICK = (40, 4), (4, 1)
"""Sizes of a run: number of frames, and of draws in each frame."""


def sample_uniform(count: int, limits: LookAtRange, rng: np.random.Generator, *, camera: Camera) -> Float64:
    """Draw poses (count, 4, 4) uniform in rotation, in the image and in depth: the baseline without LookAt."""
    quaternion = rng.standard_normal((count, 4))
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    sine = np.sqrt(np.maximum(1 - w * w, 1e-16))
    rotation = exp_rotation((2 * np.arctan2(sine, w) / sine)[:, None] * np.stack([x, y, z], axis=1))
    pixels = rng.uniform([0, 0], [camera.width, camera.height], (count, 2))
    depth = rng.uniform(limits.near, limits.far, (count, 1))
    return transform(rotation, np.c_[camera.normalise(pixels), np.ones(count)] * depth)


def best_of_first(
    made: Made, frame: SyntheticFrame, config: EstimateConfig, rng: np.random.Generator, draws: int
) -> dict[str, Float64]:
    """Return by space the least loss (K,) of the first N candidates, for the N in ``COUNTS``, mean over the draws."""
    plan = made.plan
    instrument = plan.body.instrument
    evidence = gather_evidence(frame.mask, plan.camera, instrument, ignore=frame.ignore, seed=config.seed)
    low, high = instrument.limits.T
    readings = Readings(
        values=np.array([frame.readings[name] for name in instrument.joint_names]),
        sigma=np.deg2rad([config.readings.of(name) for name in instrument.joint_names]),
        low=low,
        high=high,
    )
    renderer = Renderer(plan.body, plan.camera, threads=config.threads)
    small = renderer.at(*search_size(evidence, config.search.width_px))
    objective = Objective(small, evidence, readings, config)
    weights = replace(config.weights, readings=0.0)
    best: dict[str, list[Float64]] = {space: [] for space in SPACES}
    for _ in range(draws):
        for space in SPACES:
            count = max(COUNTS)
            if space in (UNIFORM, CENTRED):
                if space == UNIFORM:
                    poses = sample_uniform(count, LIMITS, rng, camera=plan.camera)
                else:
                    distances = rng.uniform(LIMITS.near, LIMITS.far, count)
                    poses = sample_lookat(distances, LIMITS, rng, camera=plan.camera)
                joints = sample_joints(readings, np.zeros(count, dtype=np.bool_), rng)
                at = Posed(poses, joints)
            else:
                search = replace(config.search, samples=count, use_edges=space == EDGES, uniform_joints_share=0.0)
                at, _ = draw_starts(evidence, instrument, readings, replace(config, search=search), rng)
            losses = objective.terms(at).total(weights)[rng.permutation(count)]
            best[space].append(np.minimum.accumulate(losses)[np.array(COUNTS) - 1])
    return {space: np.mean(found, axis=0) for space, found in best.items()}


def claims_of(curves: dict[str, Float64]) -> list[Claim]:
    """Evaluate the claims: an order of the spaces at every N, in the median and with separate quartiles."""
    claims = []
    for better, worse in ((EDGES, LOOKAT), (LOOKAT, UNIFORM)):
        medians = [np.median(curves[space], axis=0) for space in (better, worse)]
        top, bottom = np.percentile(curves[better], 75, axis=0), np.percentile(curves[worse], 25, axis=0)
        ordered = bool((medians[0] < medians[1]).all())
        apart = np.asarray(COUNTS)[top < bottom]
        frames = (curves[better] < curves[worse]).mean(axis=0)
        claims += [
            Claim(
                f"{better} is below {worse} at every N, in the median over frames",
                ordered,
                f"{frames.min():.0%} of the frames or more at every N",
            ),
            Claim(
                f"{better} is below {worse} at every N beyond the spread over frames (quartiles do not overlap)",
                len(apart) == len(COUNTS),
                "at N = " + ", ".join(map(str, apart)) if len(apart) else "at no N",
            ),
        ]
    return claims


def draw(curves: dict[str, Float64]) -> Figure:
    """Draw the medians over frames with their quartiles."""
    figure = new_figure(6.6, 4.6)
    panel = figure.subplots()
    for space, colour in zip(SPACES, ("#8d99ae", "#e9c46a", "#e76f51", "#1d3557"), strict=True):
        low, middle, high = np.percentile(curves[space], [25, 50, 75], axis=0)
        panel.plot(COUNTS, middle, "o-", color=colour, label=space)
        panel.fill_between(COUNTS, low, high, color=colour, alpha=0.2, linewidth=0)
    panel.set_xscale("log")
    panel.set_xticks(COUNTS, [str(count) for count in COUNTS])
    panel.minorticks_off()
    panel.set_xlabel("samples N")
    panel.set_ylabel("loss of the best of N")
    panel.set_ylim(bottom=0)
    panel.legend()
    panel.grid(alpha=0.3)
    return figure


def run(options: Options) -> None:
    """Run the experiment and write its files."""
    frames, draws = QUICK if options.quick else FULL
    config = EstimateConfig()
    made = make(prepare("lnd"), "medium", frames, 400 + options.seed, motion="free")
    rng = np.random.default_rng(options.seed)
    found = []
    for k, frame in enumerate(made.frames, start=1):
        found.append(best_of_first(made, frame, config, rng, draws))
        progress("frames", k, frames)
    curves = {space: np.array([one[space] for one in found]) for space in SPACES}
    rows = [(str(count), *(_quartiles(curves[space][:, k]) for space in SPACES)) for k, count in enumerate(COUNTS)]
    write_experiment(
        options,
        "figure4",
        title="Figure 4: the best of N candidates",
        figures={
            "samples": list(COUNTS),
            "loss_percentiles_25_50_75": {
                space: np.round(np.percentile(curves[space], [25, 50, 75], axis=0), 5).tolist() for space in SPACES
            },
        },
        claims=claims_of(curves),
        table=markdown(("N", *SPACES), rows),
        picture=draw(curves),
        note=(
            f"Median and quartiles over {frames} frames (`dvrk-cmaes synth --level medium --motion free`), each "
            f"the mean of {draws} draws. The loss is per pixel of the mask: an empty image scores "
            f"{config.weights.mse + config.weights.scale:g}. A root on the optical axis is not where these frames have "
            "it, and no gradient follows here as in the paper."
        ),
    )


def _quartiles(values: Float64) -> str:
    """Format the median and the quartiles of values."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.3f} ({low:.3f} to {high:.3f})"
