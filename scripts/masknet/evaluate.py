"""Compare the network's masks with labelled pictures of laboratories, none of which it was trained on.

``python -m masknet.evaluate NETWORK.onnx`` prints for each group of ../shared/frames: the overlap (intersection over
union) of all labelled tools together with the mask at probability .5, the mean over tools of the best overlap of a
connected piece, and where points are labelled the share of these near the outline.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from measuring.pictures import GROUPS, Picture, pictures_of
from measuring.report import SHARED
from numpy.typing import NDArray
from worlds.drawing import draw_image, picture
from worlds.motion import draw_motion, frame_times
from worlds.table import worlds

from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.frames.seen_view import overlap_of
from dvrk_cmaes.segment.around import segmentation_around
from dvrk_cmaes.segment.prompts import draw_prompts
from dvrk_cmaes.synth.scene import see

Bool = NDArray[np.bool_]
Image = NDArray[np.uint8]

SIZE: Final = 320, 256
_NEAR: Final = 10.0  # px, from a labelled point to the outline
_WORLDS: Final = 30
_LEAST: Final = 0.002  # of the image, of a piece that may be an instrument


def _worlds(frames: Path) -> Iterator[Picture]:
    """Yield drawn pictures of worlds, in groups of colour and grey ones."""
    del frames
    for world in worlds()[:_WORLDS]:
        times = frame_times(world, "session", 1)
        seen = see(world.camera, [draw_motion(world, 1, place).placed(times)[0] for place in range(world.tools)])
        drawn = draw_image(world, 1, 0, seen)
        image = np.asarray(drawn if drawn.ndim == 3 else cv2.cvtColor(drawn, cv2.COLOR_GRAY2BGR), np.uint8)
        tools = tuple((share > 0.5) & picture(world) for share in seen.coverage)
        yield Picture(world.colour, f"world {world.number}", image, world.camera, world.instrument, False, tools=tools)


ALL_GROUPS: Final[Mapping[str, Callable[[Path], Iterator[Picture]]]] = {
    **GROUPS,
    "worlds": _worlds,
    "berkeley": lambda frames: pictures_of("berkeley", frames / "labs/berkeley", "lnd"),
}


def probability(network: Any, image: Image) -> NDArray[np.float32]:
    """Return the probability of instrument at each pixel (H, W) of an image (H, W, 3) BGR."""
    small = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
    network.setInput(cv2.dnn.blobFromImage(small, 1 / 255))
    odds = network.forward()[0, 0]
    whole = cv2.resize(odds, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(1 / (1 + np.exp(-np.clip(whole, -30, 30))), np.float32)


def figures(picture: Picture, mask: Bool) -> dict[str, float]:
    """Return a mask's overlap with all tools, the mean over tools with the best piece, or points near its outline."""
    if not picture.tools:
        points = np.concatenate(picture.points)
        if not mask.any() or mask.all():
            return {"points": 0.0}
        u, v = np.clip(np.rint(points).astype(int), 0, [mask.shape[1] - 1, mask.shape[0] - 1]).T
        return {"points": float(np.mean(np.abs(signed_distance(mask))[v, u] <= _NEAR))}
    counts = np.ones_like(mask) if picture.ignore is None else ~picture.ignore
    together = np.any(picture.tools, axis=0)
    number, labels = cv2.connectedComponents((mask & counts).astype(np.uint8))
    sizes = np.bincount(labels.ravel(), minlength=number)
    pieces = [labels == k for k in range(1, number) if sizes[k] > _LEAST * mask.size]
    best = [max((overlap_of(piece, tool & counts) for piece in pieces), default=0.0) for tool in picture.tools]
    return {"all": overlap_of(mask & counts, together & counts), "tool": float(np.mean(best))}


def evaluate(
    network: Any, frames: Path, groups: Sequence[str], *, refine: bool, out: Path | None
) -> list[dict[str, Any]]:
    """Return the figures of each picture with labels; pictures with outlines are written to a folder."""
    rows = []
    for group in groups:
        for shown in ALL_GROUPS[group](frames):
            if not (shown.tools or shown.points):
                continue
            begun = time.thread_time()
            mask = probability(network, shown.image) > 0.5
            row: dict[str, Any] = {"group": shown.group, "picture": shown.name, "seconds": time.thread_time() - begun}
            row |= figures(shown, mask)
            if refine:
                prompts = draw_prompts(shown.image.shape, 1.0, None, (), ())
                if mask.any() and not mask.all():
                    mask = segmentation_around(shown.image, mask, prompts, rough=True).mask
                row |= {f"refined {key}": value for key, value in figures(shown, mask).items()}
            rows.append(row)
            if out is not None:
                drawn = shown.image.copy()
                outlines = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
                cv2.drawContours(drawn, outlines, -1, (0, 255, 255), max(1, drawn.shape[1] // 250))
                out.mkdir(parents=True, exist_ok=True)
                name = f"{shown.group}_{shown.name.replace('/', '-')}.jpg"
                cv2.imwrite(str(out / name), cv2.resize(drawn, (400, 320), interpolation=cv2.INTER_AREA))
    return rows


def main() -> None:
    """Print a row for each group."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", type=Path)
    parser.add_argument("--frames", type=Path, default=SHARED / "frames")
    parser.add_argument("--groups", nargs="+", default=[*ALL_GROUPS])
    parser.add_argument("--refine", action="store_true", help="also after the outline was moved to the edges")
    parser.add_argument("--out", type=Path, help="folder for pictures with outlines")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    network = cv2.dnn.readNetFromONNX(str(given.network))
    rows = evaluate(network, given.frames, given.groups, refine=given.refine, out=given.out)
    for group in dict.fromkeys(row["group"] for row in rows):
        own = [row for row in rows if row["group"] == group]
        means = {key: np.mean([row[key] for row in own]) for key in own[0] if key not in ("group", "picture")}
        print(f"{group:10s} {len(own):3d} " + "  ".join(f"{key} {value:.3f}" for key, value in means.items()))


if __name__ == "__main__":
    main()
