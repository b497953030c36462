"""Local refinement on the whole outline with subpixel accuracy: damped Gauss-Newton.

The residuals are the differences between antialiased coverage and mask, both slightly blurred, so that they are smooth
functions of the pose. They have a robust Cauchy loss, so that outliers of the segmentation have little influence.
Readings, given jaw tips and a session's prediction are further residuals with their own standard deviations.

Moving the outline by e along its normal adds e to the coverage there. The loss after a small change of the pose is
therefore known from the residual beside the outline and from the Jacobian of the outline's displacement, without a
silhouette (see `profiles`). An iteration minimises that, and then draws one silhouette with its outline.

The weight of the residuals of coverage relative to the readings is estimated from the residuals. Shifting a piece of
outline of length s by e changes the sum of squares of an edge blurred with sigma by s e^2 / (2 sqrt(pi) sigma), so the
remaining sum of squares gives the variance of the outline's error; ``correlation`` px of outline are one independent
measurement. Several poses are refined together, because rendering eight costs little more than rendering one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.gather import Evidence, shrunk, window_around
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.outline_jacobian import outline_jacobians
from dvrk_cmaes.pose.refine.priors import PosePrior, Priors
from dvrk_cmaes.pose.refine.profiles import Profiles, Quadratics, minimise
from dvrk_cmaes.pose.refine.selection import ALL, Selection
from dvrk_cmaes.silhouette import OutlinePoints, Renderer

Float64 = NDArray[np.float64]

_BLURRED_IN = 2.0  # standard deviations of the blur, over which the mask's value at ignored pixels reaches others
_LARGEST_DAMPING = 10.0  # beyond which a refinement stops


@dataclass(frozen=True, eq=False)
class OutlineFit:
    """A refined pose and the loss of the outline there.

    ``information`` (6 + J, 6 + J) is that of the small changes [t, r, joints] from outline and priors. ``score`` is a
    negative log-likelihood up to a constant that is the same for all modes of a frame, ``outline_score`` the part of it
    that comes from the outline, and ``residual`` the robust sum of squares of the coverage.
    """

    camera_from_root: Float64
    joints: Float64
    score: float
    outline_score: float
    residual: float
    information: Float64


@dataclass(frozen=True, eq=False)
class OutlineTerms:
    """One mask's part in a refinement of a pose on several, at that pose.

    ``loss`` is the robust sum of squares of the coverage, ``residual`` the same with the width of the configuration's
    Cauchy loss, and ``least`` that of an exact mask. ``length`` is that of the contour, px, ``count`` its number of
    independent measurements. ``prior`` is the sum of squares of the priors. ``image`` (H, W) is the blurred coverage;
    ``outline`` has its outline points, None where not asked for.
    """

    loss: float
    residual: float
    least: float
    length: float
    count: float
    prior: float
    image: NDArray[np.float32]
    outline: OutlinePoints | None


@dataclass(frozen=True, eq=False)
class OutlineDerivatives:
    """Derivatives of one mask's part at a pose, about small changes of it.

    ``profiles`` are those of the residual. ``information`` (6 + J, 6 + J) is that of half of the loss; that of half of
    the priors' sum of squares is ``prior_information``, with the slope ``prior_slope`` (6 + J,).
    """

    profiles: Profiles
    information: Float64
    prior_information: Float64
    prior_slope: Float64


class OutlineRefiner:
    """Refines poses on one frame's mask at one image size, 1 / ``shrink`` of the full size.

    ``expected`` is a prior of the pose, for example of a session. ``noise`` is the robust sum of squares
    of the residuals of coverage from which the outline's error is estimated in all fits; None to take each fit's own.
    ``confirm`` tells whether the last step, shorter than the tolerance, is drawn and undone if it raises the loss.
    """

    def __init__(
        self,
        renderer: Renderer,
        evidence: Evidence,
        readings: Readings,
        config: OutlineConfig,
        *,
        shrink: int = 1,
        expected: PosePrior | None = None,
        confirm: bool = True,
    ) -> None:
        camera = evidence.camera
        size = (camera.width, camera.height)
        if shrink > 1:
            size = max(camera.width // shrink, 8), max(camera.height // shrink, 8)
        mask, weight = evidence.mask.astype(np.float32), evidence.weight
        if shrink > 1:
            mask, weight = shrunk(mask, *size), shrunk(weight, *size)
        left, top, width, height = window_around(mask > 0, 48 // shrink + 8)
        window = np.s_[top : top + height, left : left + width]
        self._size, self._window = size, (left, top, width, height)
        self._camera = self._in_window(camera)
        self._renderer = Renderer(renderer.body, self._camera, threads=renderer.threads)
        self._config = config
        self._confirm = confirm
        beside = 2 * int(np.ceil(_BLURRED_IN * config.blur)) + 1
        clear = np.asarray(cv2.erode(weight, np.ones((beside, beside))), dtype=np.float32)
        self._weight = np.ascontiguousarray(clear[window])
        self._mask = mask[window] > 0.5
        self._target = self._blurred(np.ascontiguousarray(mask[window]))
        self.shrink = shrink
        # At smaller sizes, modes only need to be distinguished.
        self.tolerance = config.tolerance * (1 if shrink == 1 else 4)
        self.inner_steps = config.inner_steps if shrink == 1 else max(config.inner_steps // 3, 1)
        self.noise: float | None = None
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

    def _in_window(self, camera: Camera) -> Camera:
        """Return the camera of the refiner's window and size."""
        resized = camera if self._size == (camera.width, camera.height) else camera.scaled(*self._size)
        return resized.cropped(*self._window)

    @property
    def silhouettes(self) -> int:
        """Number of silhouettes rendered so far."""
        return self._renderer.poses

    @property
    def rays(self) -> int:
        """Number of rays traced so far."""
        return self._renderer.rays

    def _blurred(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), self._config.blur, borderType=cv2.BORDER_REPLICATE))

    def _render(self, poses: Float64, joints: Float64) -> list[tuple[NDArray[np.float32], OutlinePoints]]:
        """Render the blurred coverage (H, W) and the outline of each of C poses."""
        lines = self._config.lines_per_pixel
        coverage, outlines = self._renderer.coverage_and_outlines(poses, joints, lines_per_pixel=lines)
        pairs = zip(coverage, outlines.of_each(len(poses)), strict=True)
        return [(self._blurred(image), outline) for image, outline in pairs]

    def _render_coverage(
        self, poses: Float64, joints: Float64, renderer: Renderer | None = None
    ) -> list[NDArray[np.float32]]:
        """Render the blurred coverage (H, W) of each of C poses, with another renderer if one is given."""
        used = self._renderer if renderer is None else renderer
        coverage = used.coverage(poses, joints, lines_per_pixel=self._config.lines_per_pixel)
        return [self._blurred(image) for image in coverage]

    def _loss(self, image: NDArray[np.float32], cauchy: float) -> float:
        """Compute the Cauchy loss of a blurred image (H, W), which is the sum of squares for small residuals."""
        r = (image - self._target).ravel()
        near = np.flatnonzero(r != 0)  # few pixels: both images are 0 or 1 elsewhere
        r = r.take(near)
        r *= np.float32(1 / cauchy)
        r *= r
        np.log1p(r, out=r)
        r *= self._weight.ravel().take(near)
        return float(cauchy**2 * r.sum(dtype=np.float64))

    def set_noise_at(
        self, pose: Float64, joints: Float64, *, cauchy: float | None = None, camera: Camera | None = None
    ) -> None:
        """Estimate the outline's error from the residuals at a pose (4, 4) and joints (J,), for all following fits.

        Otherwise it is estimated from the residuals of each fit, to which a prior of the pose contributes. ``camera``
        is that of the pose, for images of the evidence's size, where it is not the evidence's.
        """
        width = self._config.cauchy if cauchy is None else cauchy
        renderer = self._renderer
        if camera is not None:
            renderer = Renderer(renderer.body, self._in_window(camera), threads=renderer.threads)
        self.noise = self._loss(self._render_coverage(pose[None], joints[None], renderer)[0], width)

    def _scale(self, loss: float) -> float:
        """Return the factor from sums of squares of coverage to sums of squares in standard deviations."""
        c = self._config
        loss = loss if self.noise is None else self.noise
        floor = self._length * c.noise_floor**2 / (2 * np.sqrt(np.pi) * c.blur)
        return float(self._length / c.correlation * self.shrink / max(loss, floor))

    def _outline_score(self, loss: float) -> float:
        """Compute the outline's negative log-likelihood up to a constant, with the variance estimated from the loss."""
        if self.noise is not None:
            return 0.5 * self._scale(loss) * loss
        count = self._length * self.shrink / self._config.correlation
        floor = self._length * self._config.noise_floor**2 / (2 * np.sqrt(np.pi) * self._config.blur)
        return 0.5 * count * float(np.log(max(loss, floor)))

    def _jacobians(self, outlines: Sequence[OutlinePoints], poses: Float64, joints: Float64) -> list[Float64]:
        return outline_jacobians(self._renderer.body.instrument, self._camera, outlines, poses, joints)

    @property
    def mask(self) -> NDArray[np.bool_]:
        """The part of the mask in the refiner's window, (H, W)."""
        return self._mask

    @property
    def weight(self) -> NDArray[np.float32]:
        """Weights of the pixels in the refiner's window, (H, W): 0 for ignored ones and beside them, 1 for others."""
        return self._weight

    def outline_jacobian(self, pose: Float64, joints: Float64) -> tuple[OutlinePoints, Float64]:
        """Compute the N outline points of one pose (4, 4) and their Jacobian (N, 6 + J)."""
        outline = self._renderer.outlines(pose[None], joints[None])
        return outline, self._jacobians([outline], pose[None], joints[None])[0]

    def terms_with_camera(self, pose: Float64, joints: Float64) -> tuple[Float64, Float64]:
        """Compute the outline's information (D + 3, D + 3) and slope (D + 3,) about a pose, its joints and the camera.

        ``pose`` is (4, 4), ``joints`` (J,), D = 6 + J. The last three unknowns are the logarithm of the factor of
        `Camera.changed` and its shift, px of the image at the refiner's size. Priors are not included.
        """
        ((image, outline),) = self._render(pose[None], joints[None])
        of_pose = self._jacobians([outline], pose[None], joints[None])[0]
        from_centre = outline.pixels - [self._camera.cx, self._camera.cy]
        of_focal_length = (outline.normals * from_centre).sum(axis=1)
        jacobian = np.column_stack([of_pose, of_focal_length, outline.normals])
        along = Profiles.sampled([image - self._target], self._weight, [outline], [jacobian], self._config.blur)
        information, slope = along.normal_equations(np.zeros((1, jacobian.shape[1])), self._config.cauchy)
        scale = self._scale(self._loss(image, self._config.cauchy))
        return scale * information[0], scale * slope[0]

    def terms(
        self, poses: Float64, joints: Float64, *, cauchy: float | None = None, outlines: bool = True
    ) -> list[OutlineTerms]:
        """Compute this mask's terms at each of C poses (C, 4, 4) and joints (C, J); ``cauchy`` as in `refine_all`."""
        own = self._config.cauchy
        width = own if cauchy is None else cauchy
        images = self._render(poses, joints) if outlines else [(i, None) for i in self._render_coverage(poses, joints)]
        priors = self.priors.cost(poses, joints)
        found = []
        for prior, (image, outline) in zip(priors, images, strict=True):
            loss = self._loss(image, width)
            found.append(
                OutlineTerms(
                    loss=loss,
                    residual=loss if width == own else self._loss(image, own),
                    least=self._length * self._config.noise_floor**2 / (2 * np.sqrt(np.pi) * self._config.blur),
                    length=self._length,
                    count=self._length * self.shrink / self._config.correlation,
                    prior=float(prior),
                    image=image,
                    outline=outline,
                )
            )
        return found

    def derivatives(
        self,
        images: Sequence[NDArray[np.float32]],
        outlines: Sequence[OutlinePoints],
        poses: Float64,
        joints: Float64,
        *,
        cauchy: float,
    ) -> list[OutlineDerivatives]:
        """Compute the derivatives at poses (C, 4, 4), joints (C, J) with the blurred coverages (H, W) and outlines."""
        jacobians = self._jacobians(outlines, poses, joints)
        residuals = [image - self._target for image in images]
        together = Profiles.sampled(residuals, self._weight, outlines, jacobians, self._config.blur)
        information, _ = together.normal_equations(np.zeros((len(poses), len(self.steps))), cauchy)
        priors, slopes = self.priors.terms(poses, joints)
        return [
            OutlineDerivatives(together.select([i]), information[i], prior, slope)
            for i, (prior, slope) in enumerate(zip(priors, slopes, strict=True))
        ]

    def assess(self, pose: Float64, joints: Float64) -> OutlineFit:
        """Score one pose (4, 4) and its joints (J,) without refining them."""
        return self.refine_all(pose[None], joints[None], iterations=0)[0]

    def refine_all(
        self,
        poses: Float64,
        joints: Float64,
        *,
        iterations: int | None = None,
        cauchy: float | None = None,
        selection: Selection = ALL,
    ) -> list[OutlineFit]:
        """Refine poses (C, 4, 4) and their joints (C, J); they are rendered together.

        ``iterations`` and ``cauchy`` replace those of the configuration for the refinement. Scores are always computed
        with the configuration's ``cauchy``. ``selection`` tells which of the poses take part in each iteration.
        """
        width = self._config.cauchy if cauchy is None else cauchy
        most = self._config.iterations if iterations is None else iterations
        starts = zip(poses, joints, self._render(poses, joints), self.priors.cost(poses, joints), strict=True)
        states = [
            _State(pose, joint, *drawn, loss=self._loss(drawn[0], width), prior_cost=float(cost))
            for pose, joint, drawn, cost in starts
        ]
        self._linearise(states, width)
        kept = float(len(states))
        for left in reversed(range(most)):
            outline_scores = [self._outline_score(state.loss) for state in states]
            scores = [alone + 0.5 * state.prior_cost for alone, state in zip(outline_scores, states, strict=True)]
            chosen = [states[i] for i in selection.continuing(scores, outline_scores, kept)]
            active = [state for state in chosen if not state.finished]
            if not active:
                break
            self._linearise([state for state in active if state.moved], width)
            self._advance(active, width, last=left == 0)
            kept *= selection.share
        return [self._fit(state) for state in states]

    def _advance(self, states: list[_State], width: float, *, last: bool) -> None:
        """Take one step from each state; it is kept if it lowers the loss. After the ``last`` no outline is needed."""
        steps = self._steps(states, width)
        poses = moved(np.stack([state.pose for state in states]), steps[:, :6])
        joints = np.stack([state.joints for state in states]) + steps[:, 6:]
        costs = self.priors.cost(poses, joints)
        if not self._confirm:
            left = self._take_small(states, poses, joints, steps, costs)
            if not left:
                return
            states, poses, joints = [states[i] for i in left], poses[left], joints[left]
            steps, costs = steps[left], costs[left]
        renderings = [(i, None) for i in self._render_coverage(poses, joints)] if last else self._render(poses, joints)
        trials = zip(states, poses, joints, steps, renderings, costs.tolist(), strict=True)
        for state, pose, joint, step, (image, outline), prior_cost in trials:
            loss = self._loss(image, width)
            gain = state.scale * (state.loss - loss) + state.prior_cost - prior_cost
            small = self._is_small(state, step)
            if gain <= 0:
                state.damping *= 8
                state.finished = bool(small or state.damping > _LARGEST_DAMPING)
                continue
            state.finished = bool(small or gain < 0.1 * self.tolerance)
            state.pose, state.joints, state.image, state.loss = pose, joint, image, loss
            state.prior_cost, state.moved = prior_cost, True
            state.damping = max(state.damping / 8, 1e-4)
            if outline is not None:
                state.outline = outline

    def _take_small(
        self, states: list[_State], poses: Float64, joints: Float64, steps: Float64, costs: Float64
    ) -> list[int]:
        """Move states by those of their steps that are shorter than the tolerance; returns the indices of the others.

        ``poses`` (C, 4, 4), ``joints`` (C, J) and the priors' ``costs`` (C,) are those after the ``steps`` (C, 6 + J).
        """
        small = [self._is_small(state, step) for state, step in zip(states, steps, strict=True)]
        for i in np.flatnonzero(small):
            states[i].pose, states[i].joints, states[i].finished = poses[i], joints[i], True
            states[i].prior_cost = float(costs[i])
        return [i for i, taken in enumerate(small) if not taken]

    def _is_small(self, state: _State, step: Float64) -> bool:
        """Return whether a step (6 + J,) from a state is shorter than the tolerance."""
        return bool(step @ state.information @ step < self.tolerance**2 * len(step))

    def _fit(self, state: _State) -> OutlineFit:
        """Return the refined pose of a state, scored with the configuration's Cauchy loss."""
        loss = self._loss(state.image, self._config.cauchy)
        alone = self._outline_score(loss)
        score = alone + 0.5 * state.prior_cost
        return OutlineFit(state.pose, state.joints, score, alone, loss, state.information)

    def _linearise(self, states: list[_State], cauchy: float) -> None:
        """Compute the information and slope of states at their poses, from outline and priors."""
        if not states:
            return
        poses, joints = np.stack([s.pose for s in states]), np.stack([s.joints for s in states])
        images, outlines = [s.image for s in states], [s.outline for s in states]
        derived = self.derivatives(images, outlines, poses, joints, cauchy=cauchy)
        for state, one in zip(states, derived, strict=True):
            state.scale = self._scale(state.loss)
            state.profiles, state.prior, state.prior_slope = one.profiles, one.prior_information, one.prior_slope
            state.information, state.moved = state.scale * one.information + state.prior, False

    def _steps(self, states: list[_State], cauchy: float) -> Float64:
        """Compute the damped step of each of C states, (C, 6 + J)."""
        terms = Quadratics(
            np.array([s.scale for s in states]),
            np.stack([s.prior for s in states]),
            np.stack([s.prior_slope for s in states]),
        )
        damping = np.array([s.damping for s in states])
        return minimise(Profiles.joined([s.profiles for s in states]), terms, cauchy, damping, self.inner_steps)


@dataclass(eq=False)
class _State:
    """State of the refinement of one pose."""

    pose: Float64
    joints: Float64
    image: NDArray[np.float32]
    outline: OutlinePoints
    loss: float
    prior_cost: float
    scale: float = 1.0
    information: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    prior: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    prior_slope: Float64 = field(default_factory=lambda: np.zeros(0))
    profiles: Profiles = field(init=False)
    damping: float = 1e-2
    moved: bool = False
    finished: bool = False
