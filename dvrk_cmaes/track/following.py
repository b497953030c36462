"""Following an instrument from image to image: predicted, corrected, judged, and searched for where it was lost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackResult, TrackStatus
from dvrk_cmaes.track.checkpoint import plain_hypothesis, read_hypothesis
from dvrk_cmaes.track.confirmation import CHANGED, UNCONFIRMED, Confirmation
from dvrk_cmaes.track.describe import described, without_pose
from dvrk_cmaes.track.evidence import Evidence
from dvrk_cmaes.track.hypothesis import Follower, Hypothesis, Located
from dvrk_cmaes.track.judge import AWAY, doubts_of_fit, doubts_of_pose, is_supported, tips_out_of_view
from dvrk_cmaes.track.modes import decide
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.readings import LaggedReadings
from dvrk_cmaes.track.recovery import (
    GlobalSearch,
    explains,
    has_jumped,
    is_certain,
    is_followed_instead,
    is_likely,
    same_base,
    search_around,
)
from dvrk_cmaes.track.searching import WORSE, Searching, is_better
from dvrk_cmaes.track.sight import Seen, Sight
from dvrk_cmaes.track.sliced_search import Purpose, SlicedSearch
from dvrk_cmaes.track.smoother import FilterStep
from dvrk_cmaes.track.start import based_on_arm, rebased, starting_hypotheses
from dvrk_cmaes.track.update import Fit

NOT_FOUND: Final = "not found: the first image could not be solved"


SearchLater = Callable[[Purpose, float, Anchor, Seen, Sequence[Hypothesis], Fit | None], None]
"""Begins the search of an image in the steps after it: what for, its time, s, what was known there, and its fit."""


@dataclass(frozen=True, eq=False)
class FollowingState:
    """The modes that were followed to an image, and how far they are believed; fields as of `Following`."""

    hypotheses: tuple[Hypothesis, ...]
    search: Searching
    confirmation: Confirmation

    def checkpoint(self) -> dict[str, Any]:
        """Return the state as plain values."""
        search, confirmation = self.search, self.confirmation
        return {
            "hypotheses": [plain_hypothesis(hypothesis) for hypothesis in self.hypotheses],
            "search": [search.unsupported, search.wait, search.usual, search.astray],
            "confirmation": [confirmation.credit, confirmation.left, confirmation.wait],
        }


@dataclass(eq=False)
class Following:
    """The modes that are followed, and how far they are believed.

    ``hypotheses`` are the modes, the one that is believed first; none before the first pose. ``last_step`` is the
    prediction and correction of the last image, None where the pose was found otherwise. ``searched_around`` is the
    number of images around whose prediction another pose was searched for.
    """

    follower: Follower
    rig: Rig
    sight: Sight
    solve: GlobalSearch
    readings: LaggedReadings
    config: EstimateConfig
    calibration: SessionCalibration | None
    hypotheses: list[Hypothesis] = field(default_factory=list)
    last_step: FilterStep | None = None
    searched_around: int = 0
    _search: Searching = field(default_factory=Searching)
    _confirmation: Confirmation = field(default_factory=Confirmation)

    @property
    def best(self) -> Hypothesis | None:
        """The mode that is believed; None before the first pose."""
        return self.hypotheses[0] if self.hypotheses else None

    @property
    def state(self) -> FollowingState:
        """The present state, which is not changed by what follows."""
        return FollowingState(tuple(self.hypotheses), replace(self._search), replace(self._confirmation))

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from the values of `checkpoint`; KeyError, TypeError or ValueError if they are not those."""
        self.hypotheses = [read_hypothesis(values, self.follower.model) for values in saved["hypotheses"]]
        unsupported, wait, usual, astray = saved["search"]
        usual = None if usual is None else float(usual)
        self._search = Searching(float(unsupported), float(wait), usual, int(astray))
        credit, left, wait = saved["confirmation"]
        self._confirmation = Confirmation(float(credit), int(left), int(wait))

    def anchor(self, time: float) -> Anchor:
        """Return the readings at the time of an image, based on those of the image before."""
        return self.readings.anchor(time, None if self.best is None else self.best.anchor)

    def first(self, time: float, seen: Seen) -> TrackResult:
        """Solve the first image by itself."""
        anchor = self.anchor(time)
        if seen.problem is not None:
            return without_pose(time, seen.problem)
        result = self.solve(seen, anchor, first=True)
        if result is None or result.camera_from_root is None:
            return without_pose(time, NOT_FOUND, searched=True)
        self.begin(result, self.starts(anchor, result))
        self._expect(seen)
        self.learn(seen)
        status: TrackStatus = "ok" if result.status == "ok" else "doubtful"
        return replace(self._result(time, status, result.reasons), searched=True)

    def starts(self, anchor: Anchor, result: Result) -> list[Hypothesis]:
        """Return the modes of a single frame's result as hypotheses."""
        std = self.readings.lag.std
        return starting_hypotheses(self.follower, self.config, self.calibration, anchor, std, result)

    def begin(self, result: Result, starts: list[Hypothesis], *, changed: bool = False) -> None:
        """Start all modes of a single frame's result, ``starts``; ``changed`` as in `Confirmation.start`."""
        self.hypotheses = starts
        self._search = Searching()
        self._confirmation.start(result, changed=changed)
        self.readings.forget_poses()
        self.last_step = None

    def forget(self) -> None:
        """Forget what was followed; the next image is solved by itself."""
        self.hypotheses, self.last_step = [], None
        self._search = Searching()
        self.readings.forget_poses()

    def forget_calibration(self) -> None:
        """Follow without the calibration that was given, which does not hold any more."""
        self.calibration, self.solve = None, replace(self.solve, calibration=None)
        self.readings.forget_lag()

    def _begin_anew(self, seen: Seen, result: Result, starts: list[Hypothesis], *, changed: bool = False) -> None:
        """Start from the result of images in the place of what was followed until then; arguments as of `begin`."""
        self.begin(result, starts, changed=changed)
        self._expect(seen)
        self.learn(seen, anew=True)

    def learn(self, seen: Seen, *, anew: bool = False) -> None:
        """Learn the colours of the images along the outlines of the best hypothesis; ``anew`` forgets those before."""
        views = tuple(view for view in seen.clear if seen.images[view] is not None)
        drawn = self.follower.outline(self.hypotheses[0], views) if views else None
        if drawn is not None:
            self.sight.learn(seen, *drawn, anew=anew)

    def _expect(self, seen: Seen) -> None:
        """Take the agreement of a mask with the pose that was found in it for the usual one."""
        evidence = self.sight.evidence(seen) if seen.source == "mask" else None
        corrected = None if evidence is None else self.follower.corrected(self.hypotheses[0], evidence)
        if corrected is not None:
            self._search.settle(corrected[1])

    def predicted(self, best: Hypothesis, time: float, elapsed: float, reason: str) -> TrackResult:
        """Return where a hypothesis is predicted ``elapsed`` s later, as lost for a reason, without following to it."""
        anchor = self.readings.anchor(time, best.anchor)
        ahead, _ = self.follower.predicted(best, anchor, elapsed, self.readings.lag.std)
        return self._described(ahead, time, "lost", (reason,))

    def follow(
        self,
        time: float,
        elapsed: float,
        seen: Seen,
        *,
        around: bool = True,
        search_later: SearchLater | None = None,
    ) -> TrackResult:
        """Predict all hypotheses for an image ``elapsed`` s after the last, and correct them by it.

        ``around`` is whether another pose is searched for around a prediction that the image does not support well.
        ``search_later`` begins the search of the image, which is done at once without.
        """
        anchor = self.anchor(time)
        std = self.readings.lag.std
        before = [based_on_arm(self.follower, self.config, mode, anchor, std) for mode in self.hypotheses]
        predictions = [self.follower.predicted(mode, anchor, elapsed, std) for mode in before]
        self.hypotheses = [mode for mode, _ in predictions]
        first, transition = predictions[0]
        self.last_step = FilterStep(first.state, transition, first.state, anchor)
        if seen.problem is not None and seen.masks[seen.main] is not None:
            return self._unsupported(time, seen.problem)
        if seen.any_same and self.follower.has_moved(before[0], self.hypotheses[0]):
            seen = seen.without_frozen()
        if seen.problem is not None:
            return self._unseen(time, seen.problem)
        evidence, predicted = self.sight.evidence(seen), self.hypotheses
        if evidence is None:
            return self._unsupported(time, "lost: no instrument was found in the image")
        fits = [self.follower.corrected(mode, evidence) for mode in self.hypotheses]
        track, away = self.config.track, False
        if around:
            fits[0], away = self._found_around(before[0], fits[0], anchor, evidence, seen.source)
        main = fits[0]
        fit = None if main is None else main[1]
        supported, searched = fit is not None and is_supported(fit, track), False
        if self._search.is_weak(fit, seen.source, track):
            in_view = main is not None or self.follower.outline(self.hypotheses[0], seen.clear) is not None
            gone = seen.source == "image" and not in_view
            searched = self._search.missed(fit, seen.source, track, out_of_view=gone)
            if searched and search_later is not None:
                search_later("lost", time, anchor, seen, predicted, fit if supported else None)
                searched = False
            result = self._searched(time, anchor, seen, evidence, fit if supported else None) if searched else None
            if result is not None:
                return result
        if supported:
            if any(len(sources) > 1 for sources in evidence.of_views.values()):
                drawn = self.follower.outline(predicted[0], evidence.views)
                if drawn is not None:
                    self.sight.judge(evidence, *drawn)
            result, shown = self._supported(time, seen, [pair for pair in fits if pair is not None], away=away)
            if self._confirmation.needed and shown:
                result = self._confirmed(time, anchor, seen, result, search_later)
        else:
            result = self._unsupported(time, f"lost: the {seen.source}'s edges do not support the predicted outline")
        return replace(result, searched=searched or result.searched)

    def decided(self, search: SlicedSearch) -> TrackResult | None:
        """Decide whether to go on from what the search of an image has found; None to go on as before.

        If so, the images after that one are to be followed anew.
        """
        solved, present, last = search.call.value(), self.hypotheses, self.last_step
        found: TrackResult | None = None
        if search.purpose == "first":
            if solved is not None and solved.camera_from_root is not None:
                self.begin(solved, self.starts(search.anchor, solved))
                self._expect(search.seen)
                self.learn(search.seen)
                status: TrackStatus = "ok" if solved.status == "ok" else "doubtful"
                found = replace(self._result(search.time, status, solved.reasons), searched=True)
        elif solved is not None and self.best is not None:
            self.hypotheses = list(search.hypotheses)
            if search.purpose == "confirm":
                found = self._confirmed_by(search, solved)
            else:
                evidence = self.sight.evidence(search.seen)
                if evidence is not None:
                    found = self._searched(search.time, search.anchor, search.seen, evidence, search.fit, solved=solved)
            if found is None:
                self.hypotheses, self.last_step = present, last
        return found

    def _confirmed_by(self, search: SlicedSearch, solved: Result) -> TrackResult | None:
        """Count an image solved by itself for or against the mode that was followed to it; None to go on with that."""
        if not self._confirmation.needed or self._confirmation.add(self.follower, self.hypotheses[0], solved):
            return None
        if solved.status != "ok":
            return None
        self._begin_anew(search.seen, solved, self.starts(search.anchor, solved), changed=True)
        return self._result(search.time, "doubtful", (CHANGED,))

    def _found_around(
        self,
        before: Hypothesis,
        main: tuple[Hypothesis, Fit] | None,
        anchor: Anchor,
        evidence: Evidence,
        source: str,
    ) -> tuple[tuple[Hypothesis, Fit] | None, bool]:
        """Return what the image corrected the prediction to, ``main``, or a better pose from a search around it.

        Also returns whether that pose lies away from where the readings say. If it did so in the images before, too,
        the base is placed anew.
        """
        away = False
        if self._search.is_weak(main and main[1], source, self.config.track):
            self.searched_around += 1
            nearby = search_around(self.follower, before, self.hypotheses[0], main and main[0], evidence)
            if nearby is not None and is_followed_instead(nearby[1], main and main[1], source, self.config.track):
                main, away = nearby, anchor.moves_from(before.anchor)
                self.last_step = None
                if not is_certain(nearby[1], source) or has_jumped(self.follower, before, nearby[0]):
                    self._confirmation.doubt()
        if self._search.is_led_astray(away=away) and main is not None:
            main = rebased(self.follower, self.config, main[0], anchor, self.readings.lag.std), main[1]
            self.readings.forget_poses()
        return main, away

    def _confirmed(
        self, time: float, anchor: Anchor, seen: Seen, result: TrackResult, search_later: SearchLater | None
    ) -> TrackResult:
        """Return a result as doubtful until images solved by themselves confirm the pose; go on from their pose."""
        doubtful = replace(result, status="doubtful", reasons=(UNCONFIRMED, *result.reasons))
        if not self._confirmation.due():
            return doubtful
        if search_later is not None:
            search_later("confirm", time, anchor, seen, self.hypotheses, None)
            return doubtful
        solved = self.solve(seen, anchor)
        if solved is not None:
            agrees = self._confirmation.add(self.follower, self.hypotheses[0], solved)
            if not agrees and solved.status == "ok":
                self._begin_anew(seen, solved, self.starts(anchor, solved), changed=True)
                doubtful = self._result(time, "doubtful", (CHANGED,))
        return replace(doubtful if self._confirmation.needed else result, searched=True)

    def _supported(
        self, time: float, seen: Seen, fits: list[tuple[Hypothesis, Fit]], *, away: bool
    ) -> tuple[TrackResult, bool]:
        """Keep the corrected hypotheses, decide between them, and judge the best one.

        ``away`` tells that its pose was found away from where the readings say. Also returns whether the image shows
        the pose without doubt, however uncertain it is: its standard deviation may stay near the largest that is ok.
        """
        track, decision = self.config.track, decide(fits)
        self.hypotheses, fit = decision.kept, decision.fit
        reasons = [*decision.reasons, *doubts_of_fit(fit, track, seen.source, self.rig.names)]
        if away:
            reasons.append(AWAY)
        if decision.switched:
            self.last_step = None
            self.readings.forget_poses()
        located = self.follower.located(self.hypotheses[0])
        if not self._search.is_weak(fit, seen.source, track):
            if len(self.hypotheses) == 1:
                self.readings.learn_lag(time, self.hypotheses[0], located)
            if not reasons:
                self.learn(seen)
            if self._search.unsupported >= 1:
                reasons.append("found again: one image supports the pose so far")
            self._search.found(fit)
        elif not reasons:
            reasons.append(WORSE)
        result = self._result(time, "doubtful" if reasons else "ok", tuple(reasons), located)
        shown = not reasons and not tips_out_of_view(located.tips, self.rig)
        return replace(result, residual_px=fit.sigma), shown

    def _unsupported(self, time: float, reason: str) -> TrackResult:
        """Return the prediction of an image that does not support it."""
        return self._result(time, "lost", (reason,))

    def _unseen(self, time: float, reason: str) -> TrackResult:
        """Return the prediction of an image in which nothing can be seen; doubtful as long as it is certain."""
        result = self._result(time, "doubtful", (reason,))
        certain = result.tip_std_mm is None or result.tip_std_mm <= self.config.track.largest_tip_mm
        return result if certain else replace(result, status="lost")

    def _searched(
        self,
        time: float,
        anchor: Anchor,
        seen: Seen,
        evidence: Evidence,
        fit: Fit | None,
        *,
        solved: Result | None = None,
    ) -> TrackResult | None:
        """Search an image globally, and go on from what is found; None if that does not explain the image.

        What is found must be clearly better supported than the followed pose, whose ``fit`` is given if the image
        supports it at all. Otherwise an image must support it by the colours that were learned at confirmed poses.
        ``solved`` is the result of the search, if it was done before.
        """
        result = self.solve(seen, anchor) if solved is None else solved
        reason = "found again by a global search"
        if result is None or not explains(result, self.config.trust):
            return None
        on_same_base = same_base(self.follower, self.hypotheses[0], result, evidence)
        starts = [] if on_same_base is not None else self.starts(anchor, result)
        if fit is not None or (seen.source == "image" and not self._confirmation.needed):
            other = self.follower.corrected(starts[0], evidence) if on_same_base is None else on_same_base
            found = None if other is None else other[1]
            if fit is None:
                if not is_likely(found, seen.source, self.config.track):
                    return None
            elif found is None or not is_better(found, fit) or not self._is_known(result):
                self._search.settle(fit)
                return None
        if on_same_base is not None:
            self.hypotheses = [on_same_base[0]]
            self.last_step = None
        else:
            self._begin_anew(seen, result, starts)
            reason += ", away from where the readings say: readings jumped, or the base moved"
        return replace(self._result(time, "doubtful", (reason,)), searched=True)

    def _is_known(self, result: Result) -> bool:
        """Whether a single frame tells where the tips are nearly as well as the followed pose does."""
        now = self.follower.located(self.hypotheses[0]).tip_std * 1e3
        least = max(now, self.config.track.largest_tip_mm)
        return result.expected_error is not None and result.expected_error.of_tips_mm <= least

    def _result(
        self, time: float, status: TrackStatus, reasons: tuple[str, ...], located: Located | None = None
    ) -> TrackResult:
        """Describe the best hypothesis, which is ``located`` if that is given."""
        return self._described(self.hypotheses[0], time, status, reasons, located)

    def _described(
        self,
        best: Hypothesis,
        time: float,
        status: TrackStatus,
        reasons: tuple[str, ...],
        located: Located | None = None,
    ) -> TrackResult:
        """Describe a hypothesis, which is ``located`` if that is given."""
        located = self.follower.located(best) if located is None else located
        doubts = tuple(doubts_of_pose(located, self.rig, self.config.track))
        if status == "ok" and doubts:
            status = "doubtful"
        result = TrackResult(time, status, (*reasons, *doubts) if status != "ok" else (), None, {}, None, None, None)
        return described(self.follower, best, result, located)
