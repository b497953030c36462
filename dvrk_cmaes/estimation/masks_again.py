"""The masks of a frame, found in its images once more around the silhouettes that its calibrated session expects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.frames.field_of_view import outside_view
from dvrk_cmaes.frames.frame import FrameFiles, read_frame_image
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.segment.segmentation import GUESS, Hints, SegmentSettings
from dvrk_cmaes.segment.silhouette_prior import segment_again


@dataclass(frozen=True, eq=False)
class ImagesOfFrame:
    """The images in which the masks of a frame were found by the classic model: ``files`` have no masks.

    ``settings`` have the backgrounds of the views, ``hints`` are the prompts in the first view.
    """

    files: FrameFiles
    rig: Rig
    settings: SegmentSettings
    hints: Hints = field(default_factory=Hints)

    def __call__(self, silhouettes: Mapping[str, Bool], masks: Mapping[str, Bool]) -> dict[str, Bool]:
        """Find the masks (H, W) of the views around silhouettes, by name; ``masks`` are the first ones.

        A view is left out whose silhouette is not near its first mask, if that is given, or whose new mask would be a
        guess. Errors as `read_frame_image`.
        """
        found = {}
        for number, view in enumerate(read_frame_image(self.files, self.rig).views):
            if view.image is None or view.name not in silhouettes:
                continue
            outside = outside_view(view.image)
            again = segment_again(
                view.image,
                silhouettes[view.name],
                masks.get(view.name),
                view.without(outside).ignore,
                hints=Hints() if number else self.hints,
                outside=outside,
                background=self.settings.backgrounds.get(view.name),
            )
            if again is not None and again.confidence >= GUESS:
                found[view.name] = again.mask
        return found
