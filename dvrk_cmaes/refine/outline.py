"""Local refinement on the whole outline, below a pixel: damped Gauss-Newton with central differences.

The residuals are the differences of antialiased coverage and mask, both slightly blurred, so that they answer smoothly
to a step of a fraction of a pixel. Large ones count little (Cauchy), so that a wrong stretch of outline does not drag
the pose. Readings, given jaw tips and a session's prediction are further residuals with their own spread.

Moving the outline by e along its normal adds e to the coverage under it, so the sum's gradient is an integral along the
outline: of the outline's speed, by central differences of the projection of its points on the instrument, times the
blurred residual there. One silhouette and its outline stand in for a silhouette for every parameter and direction.

What a residual of coverage is worth against a reading follows from the outline itself: shifting a stretch of outline
of length s by e changes the sum of squares of an edge blurred with sigma by s e^2 / (2 sqrt(pi) sigma), so the sum of
squares left over says how far the outline is off, and ``correlation`` px of outline make one independent measurement.
Several poses are refined in step, since drawing eight costs little more than drawing one.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence import Evidence, shrunk, window_around
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.noise import OutlineNoise, sampled, signed_distance
from dvrk_cmaes.objective import Readings
from dvrk_cmaes.refine.priors import PosePrior, Priors
from dvrk_cmaes.silhouette import OutlinePoints, Renderer

Float64 = NDArray[np.float64]

_ANYWHERE, _ANY_TURN = 1.0, np.pi  # m and rad: nothing is less certain than this


@dataclass(frozen=True)
class OutlineConfig:
    """How the outline is fitted.

    ``blur`` px of the level's image; ``cauchy`` is the coverage difference beyond which a residual counts less,
    ``small_cauchy`` that on smaller images, ``last_cauchy`` that of the last steps at full size, when all but a
    segmenter's mistakes is small; ``correlation`` px of outline make one measurement until the frame's own length is
    known; ``noise_floor`` px, the least error an outline is given; ``keypoint_sigma`` px of given tips; ``tolerance``
    in standard deviations, below which a step is the last. ``steps`` are those of the differences: along the root's
    axes, m, about them, rad, and of the joints, rad.
    """

    iterations: int = 40
    blur: float = 1.2
    lines_per_pixel: int = 2
    outline_lines: int = 1
    cauchy: float = 0.5
    small_cauchy: float = 0.25
    last_cauchy: float = 0.08
    correlation: float = 8.0
    noise_floor: float = 0.15
    keypoint_sigma: float = 2.0
    translation_step: float = 1e-4
    swing_step: float = 2e-3
    turn_step: float = 1e-2
    joint_step: float = 1e-2
    tolerance: float = 0.05


@dataclass(frozen=True, eq=False)
class OutlineFit:
    """A refined pose and what the outline says of it.

    ``information`` (6 + J, 6 + J) is that of the small changes [t, r, joints], readings included;
    ``score`` is a negative log-likelihood up to a constant, comparable between modes of one frame, and
    ``outline_score`` the outline's part of it.
    """

    camera_from_root: Float64
    joints: Float64
    score: float
    outline_score: float
    residual: float
    information: Float64


class OutlineRefiner:
    """Refines poses against one frame's mask at one image size (1 / ``shrink`` of the full one)."""

    def __init__(
        self,
        renderer: Renderer,
        evidence: Evidence,
        readings: Readings,
        config: OutlineConfig,
        *,
        shrink: int = 1,
        expected: PosePrior | None = None,
    ) -> None:
        camera = evidence.camera
        if shrink > 1:
            camera = camera.scaled(max(camera.width // shrink, 8), max(camera.height // shrink, 8))
        size = (camera.width, camera.height)
        mask, weight = evidence.mask.astype(np.float32), evidence.weight
        if shrink > 1:
            mask, weight = shrunk(mask, *size), shrunk(weight, *size)
        left, top, width, height = window_around(mask > 0, 48 // shrink + 8)
        window = np.s_[top : top + height, left : left + width]
        self._camera: Camera = camera.cropped(left, top, width, height)
        self._renderer = Renderer(renderer.body, self._camera, threads=renderer.threads)
        self._config = config
        self._weight = np.ascontiguousarray(weight[window])
        self._mask = mask[window] > 0.5
        self._target = self._blurred(np.ascontiguousarray(mask[window]))
        self._shrink = shrink
        self._tolerance = config.tolerance * (1 if shrink == 1 else 4)  # smaller images only tell modes apart
        self._balance: float | None = None
        self._length = max(len(evidence.contour.pixels) / shrink, 20.0)
        joints = len(readings.values)
        c = config
        self.steps = np.array(
            [c.translation_step] * 3 + [c.swing_step] * 2 + [c.turn_step] + [c.joint_step] * joints
        ) * np.array([shrink] * 3 + [shrink] * 2 + [min(shrink, 3)] + [min(shrink, 3)] * joints)
        self.priors = Priors(
            renderer.body.instrument,
            evidence,
            readings,
            keypoint_sigma=c.keypoint_sigma,
            steps=self.steps,
            expected=expected,
        )

    @property
    def silhouettes(self) -> int:
        """Number of silhouettes drawn so far."""
        return self._renderer.poses

    @property
    def rays(self) -> int:
        """Number of rays traced so far."""
        return self._renderer.rays

    def _blurred(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), self._config.blur, borderType=cv2.BORDER_REPLICATE))

    def _images(self, poses: Float64, joints: Float64) -> NDArray[np.float32]:
        """Blurred coverage of C poses, (C, N), flat."""
        coverage = self._renderer.coverage(poses, joints, lines_per_pixel=self._config.lines_per_pixel)
        return np.stack([self._blurred(image).ravel() for image in coverage])

    def _loss(self, image: NDArray[np.float32], cauchy: float) -> float:
        """Cauchy's loss of a blurred image (N,): a sum of squares while all is small."""
        r = (image - self._target.ravel()) / np.float32(cauchy)
        return float(cauchy**2 * (self._weight.ravel() * np.log1p(r * r)).sum(dtype=np.float64))

    def balance_at(self, pose: Float64, joints: Float64, *, cauchy: float | None = None) -> None:
        """Take the outline's error from a pose (4, 4) and joints (J,) for all that follows, instead of from each fit.

        So what an expectation leaves over is not taken for noise.
        """
        width = self._config.cauchy if cauchy is None else cauchy
        self._balance = self._loss(self._images(pose[None], joints[None])[0], width)

    def _scale(self, loss: float) -> float:
        """Measurements per unit of loss: turns sums of squares of coverage into those of standard deviations."""
        c = self._config
        loss = loss if self._balance is None else self._balance
        floor = self._length * c.noise_floor**2 / (2 * np.sqrt(np.pi) * c.blur)
        return float(self._length / c.correlation * self._shrink / max(loss, floor))

    def _outline_score(self, loss: float) -> float:
        """Negative log-likelihood of the outline up to a constant, its error unknown."""
        count = self._length * self._shrink / self._config.correlation
        floor = self._length * self._config.noise_floor**2 / (2 * np.sqrt(np.pi) * self._config.blur)
        return 0.5 * count * float(np.log(max(loss, floor)))

    def _normal_equations(
        self, poses: Float64, joints: Float64, images: NDArray[np.float32], cauchy: float
    ) -> tuple[Float64, Float64]:
        """Outline's information (C, D, D) and gradient (C, D), in sums of squares of coverage."""
        config = self._config
        outline = self._renderer.outlines(poses, joints, lines_per_pixel=config.outline_lines)
        count = len(self.steps)
        information, gradient = np.zeros((len(poses), count, count)), np.zeros((len(poses), count))
        speeds = self._speeds(outline, poses, joints)
        lengths = np.linalg.norm(outline.normals, axis=1)
        for i, image in enumerate(images):
            mine = np.flatnonzero(outline.pose == i)
            speed = speeds[:, mine]
            r = (image - self._target.ravel()).reshape(self._target.shape)
            weight = self._weight / (1 + (r / np.float32(cauchy)) ** 2)
            pull = sampled(self._blurred(weight * r), outline.pixels[mine])
            trust = sampled(self._blurred(weight), outline.pixels[mine])
            information[i] = (speed * (trust / (2 * np.sqrt(np.pi) * config.blur * lengths[mine]))) @ speed.T
            gradient[i] = speed @ pull
        return information, gradient

    def _speeds(self, outline: OutlinePoints, poses: Float64, joints: Float64) -> Float64:
        """How fast the outline points of C poses move along their normals with each small change, (D, N).

        Times the stretch of outline that a point stands for; by central differences of the projection of the point,
        which stays where it is on the instrument.
        """
        count = len(self.steps)
        change = np.concatenate([np.diag(self.steps), -np.diag(self.steps)])
        changed = moved(poses[:, None], change[:, :6]).reshape(-1, 4, 4)
        bent = (joints[:, None] + change[:, 6:]).reshape(len(changed), -1)
        links = self._renderer.body.camera_from_links(changed, bent).astype(np.float32)
        links = links.reshape(len(poses), 2 * count, -1, 4, 4).transpose(0, 2, 1, 3, 4)
        to_camera = links[outline.pose, outline.link]
        x, y, z = outline.points.astype(np.float32).T[:, :, None, None]
        points = (
            to_camera[..., :3, 0] * x + to_camera[..., :3, 1] * y + to_camera[..., :3, 2] * z + to_camera[..., :3, 3]
        )
        np.maximum(points[..., 2], np.float32(1e-4), out=points[..., 2])
        seen = self._camera.project(points)
        rate = (seen[:, :count] - seen[:, count:]) / (2 * self.steps[:, None])
        return np.asarray((rate * outline.normals[:, None]).sum(axis=-1).T)

    def information(self, fit: OutlineFit, noise: OutlineNoise) -> Float64:
        """Information (D, D) that outline and priors hold about the small changes of a fitted pose."""
        information = self.outline_information(fit, noise)
        self.priors.add(information, np.zeros(len(information)), fit.camera_from_root, fit.joints)
        return np.asarray(information + np.diag([1 / _ANYWHERE**2] * 3 + [1 / _ANY_TURN**2] * (len(self.steps) - 3)))

    def outline_information(self, fit: OutlineFit, noise: OutlineNoise) -> Float64:
        """Information (D, D) that the outline alone holds about the small changes of a fitted pose.

        Each ``noise.length`` px of outline is one measurement with ``noise.sigma``; what lies more than three of these
        away from the mask's outline, or is ignored, is none.
        """
        outline = self._renderer.outlines(
            fit.camera_from_root[None], fit.joints[None], lines_per_pixel=self._config.outline_lines
        )
        off = sampled(signed_distance(self._mask), outline.pixels)
        counts = sampled(self._weight, outline.pixels) * (np.abs(off) < 3 * max(noise.sigma, 0.5))
        speed = self._speeds(outline, fit.camera_from_root[None], fit.joints[None])
        length = np.linalg.norm(outline.normals, axis=1)
        return np.asarray((speed * (counts / length)) @ speed.T / (noise.sigma**2 * noise.length))

    def assess(self, pose: Float64, joints: Float64) -> OutlineFit:
        """Score one pose (4, 4) and its joints (J,) as they are."""
        return self.refine_all(pose[None], joints[None], iterations=0)[0]

    def refine_all(
        self, poses: Float64, joints: Float64, *, iterations: int | None = None, cauchy: float | None = None
    ) -> list[OutlineFit]:
        """Refine poses (C, 4, 4) and their joints (C, J), each on its own but in step with the others.

        ``cauchy`` replaces the configuration's for the refinement; scores are those of the configuration's.
        """
        width = self._config.cauchy if cauchy is None else cauchy
        states = [_State(pose, joint) for pose, joint in zip(poses, joints, strict=True)]
        for state, image in zip(states, self._images(poses, joints), strict=True):
            state.image, state.loss = image, self._loss(image, width)
        self._linearise(states, width)
        most = self._config.iterations if iterations is None else iterations
        for _ in range(most):
            active = [state for state in states if not state.finished]
            if not active:
                break
            trials = [self._step(state) for state in active]
            images = self._images(np.stack([t[0] for t in trials]), np.stack([t[1] for t in trials]))
            improved = []
            for state, (pose, joint, step), image in zip(active, trials, images, strict=True):
                loss = self._loss(image, width)
                cost = state.scale * loss + self.priors.cost(pose, joint)
                gain = state.scale * state.loss + self.priors.cost(state.pose, state.joints) - cost
                if gain <= 0:
                    state.damping *= 8
                    state.finished = state.damping > 1e4
                    continue
                small = step @ state.information @ step < self._tolerance**2 * len(step)
                state.finished = bool(small or gain < 0.1 * self._tolerance)
                state.pose, state.joints, state.image, state.loss = pose, joint, image, loss
                state.damping = max(state.damping / 8, 1e-4)
                improved.append(state)
            self._linearise(improved, width)
        fits = []
        for state in states:
            loss = self._loss(state.image, self._config.cauchy)
            alone = self._outline_score(loss)
            if self._balance is not None:
                alone = 0.5 * self._scale(loss) * loss
            score = alone + 0.5 * self.priors.cost(state.pose, state.joints)
            fits.append(OutlineFit(state.pose, state.joints, score, alone, loss, state.information))
        return fits

    def _linearise(self, states: list[_State], cauchy: float) -> None:
        """Compute information and slope of states at their poses, all evidence included."""
        if not states:
            return
        poses, joints = np.stack([s.pose for s in states]), np.stack([s.joints for s in states])
        outline, gradient = self._normal_equations(poses, joints, np.stack([s.image for s in states]), cauchy)
        for i, state in enumerate(states):
            state.scale = self._scale(state.loss)
            state.information, state.slope = state.scale * outline[i], state.scale * gradient[i]
            self.priors.add(state.information, state.slope, state.pose, state.joints)

    def _step(self, state: _State) -> tuple[Float64, Float64, Float64]:
        """Damped Gauss-Newton: the next pose, joints, and the step."""
        damped = state.information + state.damping * np.diag(np.diag(state.information) + 1e-9)
        step = np.asarray(-np.linalg.solve(damped, state.slope), dtype=np.float64)
        return moved(state.pose, step[:6]), state.joints + step[6:], step


@dataclass(eq=False)
class _State:
    """One pose on its way."""

    pose: Float64
    joints: Float64
    image: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, dtype=np.float32))
    loss: float = np.inf
    scale: float = 1.0
    information: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    slope: Float64 = field(default_factory=lambda: np.zeros(0))
    damping: float = 1e-2
    finished: bool = False
