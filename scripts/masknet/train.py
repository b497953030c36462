"""Train the network on pictures composed of drawn layers, for some minutes; a run that was stopped goes on.

The network is an encoder and a decoder with skips, of a million weights. ``python -m masknet.train LAYERS OUT --minutes
80`` writes OUT/checkpoint.pt every minute (weights, their moving averages, optimiser, steps and seconds so far) and a
line to OUT/log.csv: seconds, processor seconds, steps, pictures, layers of instruments, loss. At the end, also of a
training that had ended before, the averages go to OUT/network.onnx as half floats, which OpenCV's dnn reads. Needs
PyTorch and onnx, which the package does not.
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import nn
from torch.nn import functional

from masknet.compose import Layers, Random, compose

_CHANNELS: Final = 16, 32, 64, 112
_DILATIONS: Final = 1, 2, 4
_MEAN: Final = 0.45  # of pictures, 0 to 1
_SIZES: Final = (160, 128), (224, 176), (320, 256)
_BATCH: Final = 8, 6, 4
_SHARES: Final = np.array([[0.85, 0.10, 0.05], [0.30, 0.30, 0.40]])
"""Of batches of each size, in the beginning and in the end."""
_RATE: Final = 1.5e-3
_WARM: Final = 300  # steps
_AVERAGED: Final = 0.998
_SMOOTH: Final = 30.0  # px, in the Dice loss
_SAVED: Final = 60.0  # s


def _convolution(before: int, after: int, *, size: int = 3, stride: int = 1, dilation: int = 1) -> Any:
    padding = dilation * (size // 2)
    layer = nn.Conv2d(before, after, size, stride=stride, padding=padding, dilation=dilation, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(after))


class _Residual(nn.Module):  # type: ignore[misc]
    """Two convolutions, added to what comes in."""

    def __init__(self, before: int, after: int, dilation: int = 1) -> None:
        super().__init__()
        self.first = _convolution(before, after, dilation=dilation)
        self.second = _convolution(after, after, dilation=dilation)
        self.past = nn.Identity() if before == after else _convolution(before, after, size=1)

    def forward(self, x: Any) -> Any:
        return functional.relu(self.past(x) + self.second(functional.relu(self.first(x))))


class Network(nn.Module):  # type: ignore[misc]
    """Log-odds of instrument (N, 1, H / 2, W / 2) of pictures (N, 3, H, W), 0 to 1, BGR; H and W divisible by 16."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = _CHANNELS
        self.stem = _convolution(3, a, size=5, stride=2)
        self.quarter = nn.Sequential(_convolution(a, b, stride=2), nn.ReLU(), _Residual(b, b))
        self.eighth = nn.Sequential(_convolution(b, c, stride=2), nn.ReLU(), _Residual(c, c))
        self.deep = nn.Sequential(_convolution(c, d, stride=2), nn.ReLU(), *(_Residual(d, d, of) for of in _DILATIONS))
        self.whole = nn.Conv2d(d, d, 1)
        self.up = nn.ModuleList([_convolution(before, own, size=1) for before, own in ((d, c), (c, b), (b, a // 2))])
        self.join = nn.ModuleList([_convolution(more + own, own) for more, own in ((c, c), (b, b), (a // 2, a))])
        self.out = nn.Conv2d(a, 1, 1)
        nn.init.constant_(self.out.bias, -2.0)  # most pixels are no instrument

    def forward(self, pictures: Any) -> Any:
        """Return log-odds (N, 1, H / 2, W / 2)."""
        half = functional.relu(self.stem((pictures - _MEAN) * 4))
        quarter = self.quarter(half)
        eighth = self.eighth(quarter)
        x = self.deep(eighth)
        x = x * torch.sigmoid(self.whole(x.mean(dim=(2, 3), keepdim=True)))
        for up, join, skip in zip(self.up, self.join, (eighth, quarter, half), strict=True):
            wide = functional.interpolate(up(x), scale_factor=2, mode="bilinear", align_corners=False)
            x = functional.relu(join(torch.cat([wide, skip], dim=1)))
        return self.out(x)


def loss_of(odds: Any, masks: Any) -> Any:
    """Return cross entropy plus half the Dice loss of log-odds and masks (N, h, w)."""
    entropy = functional.binary_cross_entropy_with_logits(odds, masks)
    share = torch.sigmoid(odds)
    both, each = (share * masks).sum(dim=(1, 2)), share.sum(dim=(1, 2)) + masks.sum(dim=(1, 2))
    return entropy + 0.5 * (1 - (2 * both + _SMOOTH) / (each + _SMOOTH)).mean()


def batch_of(layers: Layers, r: Random, number: int, size: tuple[int, int]) -> tuple[Any, Any]:
    """Return pictures (N, 3, H, W), 0 to 1, and masks at half the size."""
    pairs = [compose(layers, r, size) for _ in range(number)]
    small = [cv2.resize(mask, (size[0] // 2, size[1] // 2), interpolation=cv2.INTER_AREA) for _, mask in pairs]
    pictures = torch.from_numpy(np.stack([picture for picture, _ in pairs])).permute(0, 3, 1, 2).float() / 255
    return pictures, torch.from_numpy(np.stack(small)).float() / 255


def _averaged(average: Any, network: Any, steps: int) -> None:
    """Move the moving average of weights and statistics towards those of the network."""
    keep = min(_AVERAGED, (1 + steps) / (10 + steps))
    with torch.no_grad():
        for mean, own in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
            if mean.dtype.is_floating_point:
                mean.mul_(keep).add_(own, alpha=1 - keep)
            else:
                mean.copy_(own)


def _half(model: Any) -> Any:
    """Return an ONNX model whose large tables are half floats, each cast where it is used."""
    casts = []
    for table in [table for table in model.graph.initializer if table.data_type == onnx.TensorProto.FLOAT]:
        values = numpy_helper.to_array(table)
        if values.size > 64:
            name = table.name
            table.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}_half"))
            casts.append(onnx.helper.make_node("Cast", [f"{name}_half"], [name], to=onnx.TensorProto.FLOAT))
    nodes = [*casts, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    onnx.checker.check_model(model)
    return model


def export(average: Any, out: Path) -> None:
    """Write a network as an ONNX file for one picture of the largest size."""
    width, height = _SIZES[-1]
    torch.onnx.export(average, (torch.zeros(1, 3, height, width),), str(out), opset_version=13, dynamo=False)
    onnx.save(_half(onnx.load(str(out))), str(out))


def main() -> None:
    """Train for some minutes, from the checkpoint if there is one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("layers", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float, required=True, help="of the whole training, also of earlier runs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    torch.manual_seed(given.seed)
    given.out.mkdir(parents=True, exist_ok=True)
    network = Network()
    average = copy.deepcopy(network).eval()
    optimiser = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=1e-3)
    steps, samples, before, running = 0, 0, 0.0, None
    checkpoint = given.out / "checkpoint.pt"
    if checkpoint.exists():
        kept = torch.load(checkpoint)
        network.load_state_dict(kept["network"])
        average.load_state_dict(kept["average"])
        optimiser.load_state_dict(kept["optimiser"])
        steps, samples, before, running = kept["steps"], kept["samples"], kept["seconds"], kept["loss"]
    layers = Layers(given.layers)
    begun = saved = time.monotonic()
    done = before >= 60 * given.minutes
    while not done:
        seconds = before + time.monotonic() - begun
        past = min(seconds / (60 * given.minutes), 1.0)
        r = np.random.default_rng([given.seed, steps])
        kind = int(r.choice(len(_SIZES), p=(1 - past) * _SHARES[0] + past * _SHARES[1]))
        pictures, masks = batch_of(layers, r, _BATCH[kind], _SIZES[kind])
        for group in optimiser.param_groups:
            group["lr"] = _RATE * min(1, (steps + 1) / _WARM) * max(0.01, 0.5 + 0.5 * math.cos(math.pi * past))
        with torch.autocast("cpu", dtype=torch.bfloat16):
            odds = network(pictures)
        loss = loss_of(odds.float()[:, 0], masks)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        steps, samples = steps + 1, samples + len(pictures)
        _averaged(average, network, steps)
        running = loss.item() if running is None else 0.99 * running + 0.01 * loss.item()
        done = past >= 1
        if done or time.monotonic() - saved > _SAVED:
            saved = time.monotonic()
            state = {"network": network.state_dict(), "average": average.state_dict()}
            state |= {"optimiser": optimiser.state_dict(), "steps": steps, "samples": samples}
            state |= {"seconds": seconds, "loss": running, "seed": given.seed, "layers": len(layers)}
            torch.save(state, checkpoint.with_suffix(".part"))
            checkpoint.with_suffix(".part").replace(checkpoint)
            with (given.out / "log.csv").open("a", encoding="utf-8") as log:
                used = time.process_time()
                print(f"{seconds:.0f},{used:.0f},{steps},{samples},{len(layers)},{running:.4f}", file=log)
            layers.refresh()
    export(average, given.out / "network.onnx")


if __name__ == "__main__":
    main()
