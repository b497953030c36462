"""When a pose is searched for globally while an instrument is followed."""

from __future__ import annotations

from dataclasses import dataclass

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.track.judge import is_convincing, is_supported
from dvrk_cmaes.track.update import Fit

_DOUBTFUL = 0.25  # part of an image without support that one with doubtful support counts for
_OUT_OF_VIEW = 0.1  # the same of an image in which the instrument is not expected to be seen
_SEARCH_AFTER = 2.0  # images without support before a global search
_MOST_WAIT = 32.0  # images between global searches
_CLEARLY = 0.1  # difference of agreement, as in `Fit`, from which a pose is better than another
_WORSE = 0.13  # difference from the usual agreement from which another pose is searched for
_LASTS = 3  # images in a row away from the readings after which the arm's base is taken to be another
_USUAL_SHARE = 0.05  # of an image in the agreement that is usual, if it is less

WORSE = "worse fit than before: another pose may be right, for which a search is due"


@dataclass
class Searching:
    """How long no image has supported the pose as it should, and when to search globally.

    ``unsupported`` is the number of such images, ``wait`` how many there must be for the next search. An image that
    supports the pose, but not convincingly, counts as a part of one. ``usual`` is the agreement, as in `Fit`, that
    images have had with the pose; None before the first. It is compared for masks only: an image's edges and colours
    change with what is behind the instrument. ``astray`` is the number of images in a row whose pose was
    found away from where the readings say.
    """

    unsupported: float = 0.0
    wait: float = _SEARCH_AFTER
    usual: float | None = None
    astray: int = 0

    def is_worse(self, fit: Fit, source: str) -> bool:
        """Whether a ``source``, mask or image, agrees with the pose clearly less than those before."""
        return source == "mask" and self.usual is not None and fit.agreement < self.usual - _WORSE

    def is_weak(self, fit: Fit | None, source: str, config: TrackConfig) -> bool:
        """Whether a mask or image supports the pose so badly that another one is to be searched for."""
        return fit is None or not is_convincing(fit, config) or self.is_worse(fit, source)

    def missed(self, fit: Fit | None, source: str, config: TrackConfig, *, out_of_view: bool) -> bool:
        """Count a mask or image that supports the pose badly; return whether to search in it.

        ``out_of_view`` tells that the instrument is not expected to be seen in it.
        """
        doubtful = fit is not None and is_supported(fit, config) and not self.is_worse(fit, source)
        self.unsupported += _DOUBTFUL if doubtful else _OUT_OF_VIEW if out_of_view else 1.0
        if self.unsupported < self.wait:
            return False
        self.wait = min(2 * self.wait, self.wait + _MOST_WAIT)
        return True

    def is_led_astray(self, *, away: bool) -> bool:
        """Count an image whose pose was found ``away`` from where the readings say, or not; return whether it lasts."""
        self.astray = self.astray + 1 if away else 0
        return self.astray >= _LASTS

    def found(self, fit: Fit) -> None:
        """Count an image that supports the pose as it should."""
        usual = fit.agreement if self.usual is None else self.usual
        self.unsupported, self.wait = 0.0, _SEARCH_AFTER
        self.usual = max(fit.agreement, usual + _USUAL_SHARE * (fit.agreement - usual))

    def settle(self, fit: Fit) -> None:
        """Take the agreement of an image for the usual one: the search found nothing that agrees better."""
        self.usual = fit.agreement


def is_better(fit: Fit, other: Fit) -> bool:
    """Whether a fit is clearly better supported than another."""
    return fit.agreement > other.agreement + _CLEARLY
