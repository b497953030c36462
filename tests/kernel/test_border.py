"""The kernel refuses arrays that do not fit, and reads nothing beyond those that do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dvrk_cmaes import _kernel

CAMERA = _kernel.Camera(8, 6, 10.0, 10.0, 3.5, 2.5, "plumb_bob", (), np.inf)
VERTICES = np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]])
FACES = np.array([[0, 1, 2]], dtype=np.int32)
LINKS = np.eye(4)[None, None] + [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0.1], [0, 0, 0, 0]]
BEGIN = np.array([0, 2])
IMAGE = np.zeros((6, 8), dtype=np.float32)
PIXELS = np.full((2, 2), 3.0)


def mesh() -> _kernel.Mesh:
    return _kernel.Mesh([(VERTICES, FACES)])


def points(**changed: Any) -> Any:
    given = {
        "begin": BEGIN,
        "link": np.zeros(2, dtype=np.int64),
        "points": np.zeros((2, 3)),
        "directions": PIXELS,
        "camera_from_root": LINKS[:, 0],
        "root_from_link": np.eye(4)[None, None],
        "by_joint": np.zeros((1, 3, 1, 4, 4)),
    }
    return _kernel.move_points(CAMERA, **(given | changed))


def profiles(**changed: Any) -> Any:
    given = {"begin": BEGIN, "pixels": PIXELS, "normals": PIXELS, "reach": 4, "images": [IMAGE], "target": IMAGE}
    return _kernel.sample_profiles(**(given | {"weight": IMAGE} | changed))


def equations(**changed: Any) -> Any:
    samples = np.zeros((2, 9), dtype=np.float32)
    given = {"residual": samples, "weight": samples, "jacobian": np.zeros((2, 9)), "density": np.ones(9)}
    return _kernel.normal_equations(**(given | {"begin": BEGIN, "cauchy": 1.0, "change": np.zeros((1, 9))} | changed))


def chain(**changed: Any) -> _kernel.Chain:
    given = {"parents": [-1, 0], "drivers": [0, 1], "sliding": [False, True], "multipliers": [1.0, 1.0]}
    return _kernel.Chain(**(given | {"offsets": [0.0, 0.0], "terms": np.zeros((2, 3, 4, 4))} | changed))


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "a face without its vertex": (
        lambda: _kernel.Mesh([(VERTICES, FACES + 1)]),
        "faces: expected indices of the link's vertices, got 3",
    ),
    "a negative vertex": (lambda: _kernel.Mesh([(VERTICES, FACES - 1)]), "faces: .* got -1"),
    "vertices that are not finite": (
        lambda: _kernel.Mesh([(VERTICES * np.nan, FACES)]),
        "vertices: expected finite numbers",
    ),
    "no vertices": (lambda: _kernel.Mesh([(VERTICES[:0], FACES[:0])]), "vertices: expected at least one"),
    "vertices in the plane": (
        lambda: _kernel.Mesh([(VERTICES[:, :2].copy(), FACES)]),
        r"vertices: expected an array \(N, 3\), got \(3, 2\)",
    ),
    "too few poses": (
        lambda: mesh().masks(CAMERA, LINKS[:, :0], 1, None),
        r"camera_from_link: expected an array \(N, 1, 4, 4\), got \(1, 0, 4, 4\)",
    ),
    "a pose that is not finite": (
        lambda: mesh().masks(CAMERA, np.full_like(LINKS, np.inf), 1, None),
        "camera_from_link: expected finite numbers",
    ),
    "sums of another image": (
        lambda: mesh().sums(CAMERA, LINKS, np.zeros((6, 8, 3)), 1, False, 1, None),
        r"table: expected an array \(6, 9, N\), got \(6, 8, 3\)",
    ),
    "no lines": (lambda: mesh().coverage(CAMERA, LINKS, 0, 1, None), "lines_per_pixel: expected a positive number"),
    "too many lines": (lambda: mesh().coverage(CAMERA, LINKS, 20_000, 1, None), "lines_per_pixel: expected fewer"),
    "a decision of other crossings": (
        lambda: mesh().masks(CAMERA, LINKS, 1, lambda *_: np.zeros(1, dtype=np.bool_)),
        "covered: expected an array",
    ),
    "an image without pixels": (
        lambda: _kernel.Camera(0, 6, 10.0, 10.0, 3.5, 2.5, "plumb_bob", (), np.inf),
        "width: expected a positive number",
    ),
    "two coefficients": (
        lambda: _kernel.Camera(8, 6, 10.0, 10.0, 3.5, 2.5, "plumb_bob", (0.1, 0.2), 1.0),
        "coefficients: expected 4, 5 or 8",
    ),
    "a parent after its child": (lambda: chain(parents=[1, -1]), "parents: expected every parent before its children"),
    "a parent too few": (lambda: chain(parents=[-1]), r"terms: expected an array \(1, 3, 4, 4\)"),
    "a driver too few": (lambda: chain(drivers=[0]), "joints: expected as many drivers"),
    "a driver that is no joint": (lambda: chain(drivers=[0, -2]), "drivers: expected numbers of joints"),
    "values of one joint": (
        lambda: chain().forward(np.zeros((1, 1)), [0], False),
        "values: expected one of each joint",
    ),
    "a selected joint that is not there": (
        lambda: chain().forward(np.zeros((1, 2)), [2], True),
        "selected: expected numbers of joints, or -1, got 2",
    ),
    "a link that is not there": (lambda: points(link=np.array([0, 1])), "link: expected numbers of links, got 1"),
    "offsets beyond the points": (lambda: points(begin=np.array([0, 3])), "begin: expected ascending offsets"),
    "offsets that fall": (lambda: points(begin=np.array([0, 3, 2])), "begin: expected ascending offsets"),
    "no offsets": (lambda: points(begin=BEGIN[:0]), "begin: expected ascending offsets"),
    "directions of other points": (lambda: points(directions=PIXELS[:1]), r"directions: expected an array \(2, 2\)"),
    "an image too few": (lambda: profiles(images=[]), "images: expected one of each pose"),
    "an image of another size": (lambda: profiles(images=[IMAGE.T.copy()]), r"images: expected an array \(6, 8\)"),
    "a weight of another size": (lambda: profiles(weight=IMAGE[1:]), r"weight: expected an array \(6, 8\)"),
    "a target without pixels": (
        lambda: profiles(images=[IMAGE[:0]], target=IMAGE[:0], weight=IMAGE[:0]),
        "target: expected at least one pixel",
    ),
    "no reach": (lambda: profiles(reach=0), "reach: expected a positive number"),
    "a change of other unknowns": (lambda: equations(change=np.zeros((1, 8))), r"change: expected an array \(1, 9\)"),
    "a density of other samples": (lambda: equations(density=np.ones(8)), r"density: expected an array \(9\)"),
    "losses of another size": (
        lambda: _kernel.cauchy_losses([IMAGE[1:]], IMAGE, IMAGE, 1.0),
        r"images: expected an array \(6, 8\)",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_arrays_that_do_not_fit_are_refused_by_name(name: str) -> None:
    call, message = REFUSED[name]
    with pytest.raises(ValueError, match=f"^{message}"):
        call()


@pytest.mark.parametrize("array", [LINKS.tolist(), None, "links", LINKS.astype(object)])
def test_what_is_no_array_of_numbers_is_refused(array: Any) -> None:
    with pytest.raises(TypeError):
        mesh().masks(CAMERA, array, 1, None)


@pytest.mark.parametrize("array", [LINKS.astype(np.float32), np.asfortranarray(LINKS), LINKS[..., ::-1][..., ::-1]])
def test_arrays_of_other_numbers_or_layouts_are_copied(array: np.ndarray) -> None:
    np.testing.assert_array_equal(mesh().masks(CAMERA, array, 1, None), mesh().masks(CAMERA, LINKS, 1, None))


def test_samples_beyond_the_image_are_those_of_its_border() -> None:
    image = np.arange(48, dtype=np.float32).reshape(6, 8)
    far = np.array([[-50.0, -50.0], [50.0, 50.0], [np.nan, 0.0], [1e300, -1e300]])
    residual, _ = profiles(
        images=[image], begin=np.array([0, 4]), pixels=far, normals=np.tile([1.0, 0.0], (4, 1)), weight=IMAGE
    )
    np.testing.assert_array_equal(residual[:2], np.repeat([[0.0], [47.0]], 9, axis=1))


def test_the_decision_between_crossings_is_taken() -> None:
    asked = []

    def decide(pose: int, columns: bool, line: np.ndarray, along: np.ndarray) -> np.ndarray:
        asked.append((pose, columns, len(line)))
        return np.arange(len(line)) % 2 == 0

    far = _kernel.Mesh([(10 * VERTICES - [0.05, 0.05, 0], FACES)])
    links = np.concatenate([LINKS, LINKS])
    np.testing.assert_array_equal(far.masks(CAMERA, links, 2, decide), far.masks(CAMERA, links, 2, None))
    assert [(pose, columns) for pose, columns, _ in asked] == [(0, False), (1, False)]
    assert asked[0][2] > 0


def test_an_exception_of_the_decision_is_raised() -> None:
    def decide(*_: Any) -> np.ndarray:
        raise KeyError("no")

    with pytest.raises(KeyError, match="no"):
        mesh().coverage(CAMERA, LINKS, 2, 1, decide)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300, 1e18])
def test_joints_that_are_no_angles_give_no_pose_and_no_error(value: float) -> None:
    terms = np.stack([np.stack([np.eye(4)] * 3)] * 2)
    poses, slopes = chain(terms=terms).forward(np.full((1, 2), value), [-1, 0, 1], True)
    np.testing.assert_array_equal(poses[0, 0], np.eye(4))
    assert slopes is not None
    assert slopes.shape == (1, 2, 3, 4, 4)


def test_sine_and_cosine_are_exact_to_the_last_digits() -> None:
    terms = np.zeros((1, 3, 4, 4))
    terms[0, 1, 0, 0] = terms[0, 2, 0, 1] = 1
    tree = _kernel.Chain([-1], [0], [False], [1.0], [0.0], terms)
    angles = np.concatenate([np.linspace(-10, 10, 20_001), np.arange(-8, 9) * np.pi / 4])
    poses, slopes = tree.forward(angles[:, None], [0], True)
    assert slopes is not None
    np.testing.assert_allclose(poses[:, 0, 0, :2], np.column_stack([np.sin(angles), np.cos(angles)]), atol=3e-16)
    np.testing.assert_allclose(slopes[:, 0, 0, 0, :2], np.column_stack([np.cos(angles), -np.sin(angles)]), atol=3e-16)
