"""Microseconds a silhouette beside peers, by image and mesh size; the kernel's share of frames and steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from unittest import mock

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.instrument import Instrument, Link, load_instrument
from dvrk_cmaes.silhouette import Body, PixelSums, Renderer
from measure.bench.estimate import estimated
from measure.bench.peers import Peer, all_peers
from measure.bench.track import latency

Float64 = NDArray[np.float64]

POPULATION: Final = 32
PEER_POSES: Final = 4
THREADS: Final = 2
RAYS: Final = "ours, 1 thread(s), a ray for each span"
POSE_SIGMA: Final = np.array([1e-3] * 3 + [3e-2] * 3)  # m and rad, of candidates about a golden pose
JOINT_SIGMA: Final = 5e-2  # rad
SIZES: Final = ((27, 20), (80, 60), (160, 120), (320, 240), (640, 480), (1280, 720), (1920, 1080), (3840, 2160))
FACES: Final = (1_000, 5_000, 10_000, 18_000, 40_000, 80_000)
_TRIES: Final = 12  # cell sizes of the decimation tried for a number of faces


def population(instrument: Instrument, golden: Path, count: int = POPULATION) -> tuple[Camera, Float64, Float64]:
    """Return the camera, and poses (C, 4, 4) and joints (C, J) drawn around the golden poses of a session."""
    session = read_session(golden, known=instrument.joint_names)
    truth = list(session.truth.frames.values())
    chosen = [truth[i % len(truth)] for i in range(count)]
    rng = np.random.default_rng(0)
    poses = np.array([one.camera_from_root for one in chosen])
    joints = np.array([[one.joints[name] for name in instrument.joint_names] for one in chosen])
    poses = moved(poses, rng.standard_normal((count, 6)) * POSE_SIGMA)
    return session.camera, poses, joints + rng.standard_normal(joints.shape) * JOINT_SIGMA


def median_seconds(work: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return the median seconds of each function; they are called alternately, after one warm-up call each."""
    times: dict[str, list[float]] = {name: [] for name in work}
    for done in work.values():
        done()
    for _ in range(repeats):
        for name, done in work.items():
            start = time.perf_counter()
            done()
            times[name].append(time.perf_counter() - start)
    return {name: float(np.median(values)) for name, values in times.items()}


def images_to_sum(camera: Camera) -> NDArray[np.float32]:
    """Return three images (3, H, W) like those summed in the loss: ones, a mask, a distance field."""
    v, u = np.mgrid[: camera.height, : camera.width]
    far = np.hypot(u - camera.width / 2, v - camera.height / 2) / camera.width
    return np.stack([np.ones_like(far), far < 0.25, far]).astype(np.float32)


def _disagreement(ours: NDArray[np.bool_], theirs: NDArray[np.bool_]) -> tuple[int, int]:
    """Count the pixels that differ, and those of them that are not beside an outline."""
    different, far = 0, 0
    for one, other in zip(ours, theirs, strict=True):
        differs = one != other
        band = cv2.morphologyEx(one.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
        different, far = different + int(differs.sum()), far + int((differs & ~band).sum())
    return different, far


def _compared(source: str, golden: Path, *, repeats: int) -> dict[str, Any]:
    """Compare our renderer, with one and two threads, with all peers; DvrkCmaesError if their masks disagree."""
    instrument = load_instrument(source)
    body = Body.prepare(instrument)
    camera, poses, joints = population(instrument, golden)
    images = images_to_sum(camera)
    table, flat = PixelSums.of(images), images.reshape(len(images), -1)
    renderers = {n: Renderer(body, camera, threads=n) for n in (1, THREADS)}
    few = poses[:PEER_POSES], joints[:PEER_POSES]
    masks = renderers[1].masks(*few)
    peers, left_out = all_peers(body, camera, THREADS)
    different, far = _disagreement(masks, Renderer(replace(body, method="rays"), camera, threads=1).masks(*few))
    agreement: list[dict[str, Any]] = [
        {"peer": RAYS, "pixels that differ": different / PEER_POSES, "not beside an outline": far}
    ]
    for peer in peers:
        different, far = _disagreement(masks, peer.masks(*few))
        if far:
            raise DvrkCmaesError(f"{peer.name}: {far} pixels differ that are not beside an outline")
        agreement.append(
            {"peer": peer.name, "pixels that differ": different / PEER_POSES, "not beside an outline": far}
        )

    def ours(threads: int, to_pixel: bool) -> Callable[[], object]:
        return lambda: renderers[threads].sums(poses, joints, table, to_pixel=to_pixel)

    def theirs(peer: Peer) -> Callable[[], object]:
        return lambda: peer.sums(*few, flat)

    by_rays = Renderer(replace(body, method="rays"), camera, threads=1)
    work = {f"ours, {n} thread(s)": ours(n, False) for n in renderers}
    work |= {f"ours, {n} thread(s), to the pixel": ours(n, True) for n in renderers}
    work |= {RAYS: lambda: by_rays.sums(poses, joints, table)}
    candidates = dict.fromkeys(work, len(poses)) | {peer.name: PEER_POSES for peer in peers}
    seconds = median_seconds(work | {peer.name: theirs(peer) for peer in peers}, repeats)
    each = {name: 1e6 * value / candidates[name] for name, value in seconds.items()}
    best = min(each[f"ours, {n} thread(s)"] for n in renderers)
    threads = {f"ours, {n} thread(s){rest}": str(n) for n in renderers for rest in ("", ", to the pixel")}
    threads |= {RAYS: "1"} | {peer.name: peer.threads for peer in peers}
    rows = [{"way": k, "threads": threads[k], "us a silhouette": v, "times ours": v / best} for k, v in each.items()]
    one, two = (each[f"ours, {n} thread(s)"] for n in renderers)
    faces = sum(len(link.faces) for link in instrument.links)
    ratios = {
        "triangles": faces,
        "two threads are faster by": one / two,
        "rays / count, one thread": each[RAYS] / one,
        "fastest peer / ours": min((each[p.name] for p in peers if "own" not in p.name), default=float("nan")) / best,
    }
    report: dict[str, Any] = {f"{camera.width} x {camera.height}": rows, "masks": agreement, "ratios": [ratios]}
    return report | ({"left out": [{"renderer": text} for text in left_out]} if left_out else {})


def kernel_report(source: str, golden: Path, recording: Path, *, repeats: int, frames: int | None) -> dict[str, Any]:
    """Report the comparison with peers, times by size, and the kernel's share of a frame and of a tracker's step."""
    return {
        **_compared(source, golden, repeats=repeats),
        **scale_report(source, golden, repeats=repeats),
        "processor time": [_share_of_frames(source, golden, frames), _share_of_steps(source, recording, frames)],
    }


class _TimedMesh:
    """A mesh whose methods' processor time is added up."""

    def __init__(self, mesh: _kernel.Mesh, timed: Callable[[Callable[..., Any]], Callable[..., Any]]) -> None:
        self._mesh, self._timed = mesh, timed

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._mesh, name)
        return self._timed(found) if callable(found) else found


@contextmanager
def _timed_kernel() -> Iterator[list[float]]:
    """Record the processor time, s, of each call of the kernel meanwhile."""
    spent: list[float] = []

    def timed(function: Callable[..., Any]) -> Callable[..., Any]:
        def measured(*given: Any, **named: Any) -> Any:
            started = time.process_time()
            value = function(*given, **named)
            spent.append(time.process_time() - started)
            return value

        return measured

    prepared = Body.mesh.func  # type: ignore[attr-defined]

    def mesh_of(body: Body) -> Any:
        if "untimed mesh" not in body.__dict__:
            body.__dict__["untimed mesh"] = prepared(body)
        return _TimedMesh(body.__dict__["untimed mesh"], timed)

    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(Body, "mesh", property(mesh_of)))
        for name in ("move_points", "normal_equations", "shared_equations", "minimise"):
            stack.enter_context(mock.patch.object(_kernel, name, timed(getattr(_kernel, name))))
        yield spent


def _share(what: str, each: float, count: int, spent: Sequence[float]) -> dict[str, Any]:
    """Return the processor time, s, of each of ``count`` frames or steps, and what of it is not spent in the kernel."""
    kernel = sum(spent) / count
    return {
        "of": what,
        "ms": 1e3 * each,
        "kernel, ms": 1e3 * kernel,
        "calls of it": len(spent) / count,
        "left in Python": 1 - kernel / each,
    }


def _share_of_frames(source: str, golden: Path, frames: int | None) -> dict[str, Any]:
    """Measure frames of a session, solved one by one in one thread."""
    session = read_session(golden, known=load_instrument(source).joint_names)
    chosen, config = session.frames[:frames], EstimateConfig(threads=1)
    estimated(session, session.frames[0], source, config)
    with _timed_kernel() as spent:
        started = time.process_time()
        for files in chosen:
            estimated(session, files, source, config)
        each = (time.process_time() - started) / len(chosen)
    return _share("a frame", each, len(chosen), spent)


def _share_of_steps(source: str, recording: Path, frames: int | None) -> dict[str, Any]:
    """Measure the steps of a tracker by masks, those with a search as well."""
    with _timed_kernel() as spent:
        row = latency(source, recording, frames, "masks")
    steps = row["steps"] + row["searched"]
    return _share("a step of a tracker", 1e-3 * row["CPU, mean"], steps, spent)


def _seen_at(camera: Camera, width: int, height: int) -> Camera:
    """Return a camera with the same vertical field of view, and another size and aspect ratio."""
    scale = height / camera.height
    cx = (camera.cx + 0.5 - camera.width / 2) * scale + width / 2 - 0.5
    cy = (camera.cy + 0.5) * scale - 0.5
    fx, fy = camera.fx * scale, camera.fy * scale
    return replace(camera, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)


def _divided(link: Link) -> Link:
    """Divide each face into four at the midpoints of its edges."""
    edges = np.sort(link.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    pairs, which = np.unique(edges, axis=0, return_inverse=True)
    a, b, c = link.faces.T
    ab, bc, ca = which.reshape(-1, 3).T + len(link.vertices)
    faces = np.concatenate([np.stack(f, axis=1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    vertices = np.concatenate([link.vertices, link.vertices[pairs].mean(axis=1)])
    return Link(link.name, vertices, faces.astype(np.int32))


def _faces(body: Body) -> int:
    """Return the number of faces of all links."""
    return sum(len(link.faces) for link in body.instrument.links)


def with_faces(body: Body, wanted: int) -> Body:
    """Return a body with about ``wanted`` faces, by decimation, or by division of the links with the most faces."""
    links = list(body.instrument.links)
    count = sum(len(link.faces) for link in links)
    if count > 1.15 * wanted:
        cells = np.geomspace(2e-5, 2e-3, _TRIES)
        decimated = [body.decimated(cell) for cell in cells]
        return min(decimated, key=lambda one: abs(_faces(one) - wanted))
    while count < 0.95 * wanted:
        fitting = [i for i, link in enumerate(links) if count + 3 * len(link.faces) <= 1.25 * wanted]
        if not fitting:
            break
        largest = max(fitting, key=lambda i: len(links[i].faces))
        links[largest] = _divided(links[largest])
        count = sum(len(link.faces) for link in links)
    return Body.prepare(replace(body.instrument, links=tuple(links)))


def scale_report(source: str, golden: Path, *, repeats: int) -> dict[str, Any]:
    """Measure the kernel with one thread by image and mesh size, relative to 640 x 480 and to the given mesh."""
    body = Body.prepare(load_instrument(source))
    camera, poses, joints = population(body.instrument, golden)

    def sums(body: Body, camera: Camera) -> Callable[[], object]:
        table, renderer = PixelSums.of(images_to_sum(camera)), Renderer(body, camera, threads=1)
        return lambda: renderer.sums(poses, joints, table)

    by_size = median_seconds({f"{w} x {h}": sums(body, _seen_at(camera, w, h)) for w, h in SIZES}, repeats)
    bodies = [body, *(with_faces(body, wanted) for wanted in FACES)]
    by_faces = median_seconds({str(_faces(one)): sums(one, camera) for one in bodies}, repeats)
    sizes: Sequence[dict[str, Any]] = [
        {"image": name, "us a silhouette": 1e6 * s / len(poses), "times 640 x 480": s / by_size["640 x 480"]}
        for name, s in by_size.items()
    ]
    own = by_faces[str(_faces(body))]
    meshes: Sequence[dict[str, Any]] = [
        {"triangles": int(name), "us a silhouette": 1e6 * s / len(poses), "times the mesh as it is": s / own}
        for name, s in sorted(by_faces.items(), key=lambda item: int(item[0]))
    ]
    return {"image size": sizes, "mesh size": meshes}
