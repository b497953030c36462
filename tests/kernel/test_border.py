"""The kernel refuses arrays that do not fit, and reads nothing beyond those that do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
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


def target(**changed: Any) -> _kernel.Target:
    given = {"mask": IMAGE, "weight": IMAGE + 1, "taps": [0.5, 0.25], "reach": 4}
    return _kernel.Target(**(given | changed))


def comparison(**changed: Any) -> _kernel.Comparison:
    given = {
        "target": target(),
        "camera_from_root": LINKS[:, 0],
        "root_from_link": np.eye(4)[None, None],
        "by_joint": np.zeros((1, 3, 1, 4, 4)),
        "camera_from_link": LINKS,
        "lines_per_pixel": 2,
        "cauchy": [1.0],
        "threads": 1,
        "trace": None,
    }
    return plate().compare(CAMERA, **(given | changed))[0]


def plate() -> _kernel.Mesh:
    return _kernel.Mesh([(VERTICES - [0, 0, 0.05], FACES)])


def equations(**changed: Any) -> Any:
    given = {"compared": [comparison()], "factors": [1.0], "density": [1.0] * 9, "cauchy": 1.0}
    return _kernel.normal_equations(**(given | {"change": np.zeros((1, 9))} | changed))


def of_shared(**changed: Any) -> Any:
    given = {"compared": [comparison()], "factors": [1.0], "density": [1.0] * 9, "cauchy": 1.0, "stride": 1}
    given |= {"axes": [[1.0, 0.0]], "deviations": [[1.0] * 4], "sharing": _kernel.Sharing(None, 0.01, 4)}
    given |= {"more": [], "offsets": [], "shown": _kernel.Shown(0.5, 2.0, 8.0), "views": 1}
    return _kernel.shared_equations(**(given | changed))


def shared_errors(**changed: Any) -> Any:
    shaft = _kernel.Sharing(np.array([[0.0, 0, 0], [0, 0, 1]]), 0.01, 4)
    given = {"link": np.zeros(2, dtype=np.int64), "normals": PIXELS, "points": np.zeros((2, 3)), "axis": [1.0, 0.0]}
    given |= {"deviations": [1.0] * 4, "sharing": shaft, "offsets": None, "shown": _kernel.Shown(0.5, 2.0, 8.0)}
    return _kernel.shared_errors(**(given | changed))


def contour_errors(**changed: Any) -> _kernel.ContourErrors:
    given = {"reach": 8, "least": 1, "normal_median": 1.5, "least_sigma": 0.5, "clip": 2.5, "correlated": 0.9}
    return _kernel.ContourErrors(**(given | {"length": 9.0, "farthest": 9.0, "grid": 0.1, "inflation": 1.0} | changed))


def contour(**changed: Any) -> Any:
    given = {
        "mask": IMAGE > 0,
        "weight": IMAGE + 1,
        "camera_from_root": LINKS[:, 0],
        "root_from_link": np.eye(4)[None, None],
    }
    given |= {"by_joint": np.zeros((1, 3, 1, 4, 4)), "camera_from_link": LINKS, "errors": contour_errors()}
    return plate().contours(CAMERA, **(given | {"threads": 1, "trace": None} | changed))


def minimum(**changed: Any) -> np.ndarray:
    given = {"compared": [comparison()], "factors": [1.0], "density": [1.0] * 9, "cauchy": 1.0, "weight": np.ones(1)}
    given |= {"information": np.eye(9)[None], "slope": np.zeros((1, 9)), "damping": None, "iterations": 2}
    return _kernel.minimise(**(given | {"solved": 0.0, "least": (0.0, 0.0), "farthest": 3.0} | changed))


def frames(count: int = 2, **changed: Any) -> Any:
    given = {"diagonal": np.tile(np.eye(3), (count, 1, 1)), "beside": np.zeros((max(count - 1, 0), 3, 3))}
    return _kernel.eliminate_chain(**(given | {"right": np.zeros((count, 3, 1))} | changed))


def straight(**changed: Any) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Fit a line to points along v = 3 + u / 10, of which some are outliers."""
    along = np.arange(40.0)
    points = np.column_stack([along, 3 + along / 10 + 2.5 * (np.arange(40) % 8 == 0)])
    normals = np.tile(np.array([-0.1, 1]) / np.hypot(0.1, 1), (40, 1))
    given = {"points": points, "normals": normals, "lines": np.array([[0.0, 1.0, -5.0]]), "sigma": 1.2, "near": 2.5}
    given |= {"facing": 0.93, "gap": 40.0, "least_sigma": 0.3, "reach": 3.0, "least_reach": 1.5, "normal_median": 1.48}
    return _kernel.fit_lines(**(given | {"iterations": 3, "least": 12} | changed))


def support(**changed: Any) -> tuple[np.ndarray, np.ndarray]:
    given = {"points": PIXELS, "normals": PIXELS, "lines": np.array([[0.0, 1.0, -5.0]]), "sigma": 1.2, "facing": 0.9}
    return _kernel.line_support(**(given | changed))


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
    "hits of other rays": (
        lambda: mesh().coverage(CAMERA, LINKS, 1, 1, lambda *_: np.zeros(99, dtype=np.bool_)),
        "hit: expected an array",
    ),
    "an image without pixels": (
        lambda: _kernel.Camera(0, 6, 10.0, 10.0, 3.5, 2.5, "plumb_bob", (), np.inf),
        "width: expected a positive number",
    ),
    "two coefficients": (
        lambda: _kernel.Camera(8, 6, 10.0, 10.0, 3.5, 2.5, "plumb_bob", (0.1, 0.2), 1.0),
        "coefficients: expected 4, 5 or 8",
    ),
    "normals of other points than support": (
        lambda: support(normals=PIXELS[:1]),
        r"normals: expected an array \(2, 2\)",
    ),
    "lines that are not finite": (lambda: support(lines=np.full((1, 3), np.nan)), "contour and lines: expected finite"),
    "points without a spread": (lambda: support(sigma=0.0), "sigma: expected a positive number"),
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
    "a mask without pixels": (lambda: target(mask=IMAGE[:0], weight=IMAGE[:0]), "mask: expected at least one pixel"),
    "a weight of another size": (lambda: target(weight=IMAGE[1:]), r"weight: expected an array \(6, 8\)"),
    "a mask that is not finite": (lambda: target(mask=IMAGE * np.nan), "mask: expected finite numbers"),
    "no taps": (lambda: target(taps=[]), "taps: expected 1 to 1000 of them"),
    "no reach": (lambda: target(reach=0), "reach: expected 1 to 1000 px"),
    "a target of another size": (
        lambda: comparison(target=target(mask=IMAGE.T.copy(), weight=IMAGE.T.copy())),
        "target: expected the size of the camera's images",
    ),
    "roots of other poses": (
        lambda: comparison(camera_from_root=LINKS[:0, 0]),
        r"camera_from_root: expected an array \(1, 4, 4\)",
    ),
    "links of other poses": (
        lambda: comparison(root_from_link=np.zeros((1, 2, 4, 4))),
        r"root_from_link: expected an array \(1, 1, 4, 4\)",
    ),
    "derivatives of other links": (
        lambda: comparison(by_joint=np.zeros((1, 3, 2, 4, 4))),
        r"by_joint: expected an array \(1, N, 1, 4, 4\)",
    ),
    "a loss without width": (lambda: comparison(cauchy=[0.0]), "cauchy: expected positive numbers"),
    "no comparison": (lambda: equations(compared=[None]), "compared: expected comparisons with derivatives"),
    "a comparison without outline": (
        lambda: equations(compared=[comparison(by_joint=None)]),
        "compared: expected comparisons with derivatives",
    ),
    "views without factors": (lambda: equations(factors=[]), "compared: expected as many of each pose as factors"),
    "a view too few": (lambda: equations(factors=[1.0, 1.0]), "compared: expected as many of each pose as factors"),
    "a change of other unknowns": (
        lambda: equations(change=np.zeros((1, 8))),
        "compared: expected comparisons with derivatives by as many unknowns as changes",
    ),
    "a change too few": (
        lambda: equations(change=np.zeros((0, 9))),
        "compared: expected as many of each pose as factors",
    ),
    "a density of other samples": (lambda: equations(density=[1.0] * 8), "density: expected one of each sample"),
    "a minimum with a pose too few": (
        lambda: minimum(compared=[comparison()] * 2),
        "compared: expected as many of each pose as factors",
    ),
    "a minimum of other information": (
        lambda: minimum(information=np.zeros((1, 8, 8))),
        r"information: expected an array \(1, 9, 9\)",
    ),
    "a minimum of other weights": (lambda: minimum(weight=np.ones(2)), r"weight: expected an array \(1\)"),
    "a minimum of other damping": (lambda: minimum(damping=np.ones(2)), r"damping: expected an array \(1\)"),
    "distances in a mask of one row": (
        lambda: _kernel.signed_distances(IMAGE[0] > 0, PIXELS, 10.0),
        r"mask: expected an array \(N, N\), got \(8\)",
    ),
    "distances in no mask": (
        lambda: _kernel.signed_distances(np.zeros((0, 5), np.bool_), PIXELS, 10.0),
        "mask: expected at least one pixel",
    ),
    "distances of pixels that are not finite": (
        lambda: _kernel.signed_distances(IMAGE > 0, PIXELS + np.nan, 10.0),
        "pixels: expected finite numbers",
    ),
    "distances up to none": (
        lambda: _kernel.signed_distances(IMAGE > 0, PIXELS, np.nan),
        "farthest: expected 1 to 1000000 px",
    ),
    "a rotation vector of two numbers": (
        lambda: _kernel.exp_rotation(np.zeros(2)),
        "vectors: expected an array of other",
    ),
    "a rotation of two rows": (lambda: _kernel.log_rotation(np.eye(3)[:2]), "rotations: expected an array of other"),
    "a pose of three rows": (lambda: _kernel.moved(np.eye(4)[:3], np.zeros(6)), "poses: expected an array of other"),
    "a change of five numbers": (lambda: _kernel.moved(np.eye(4), np.zeros(5)), "changes: expected an array of other"),
    "a change of nothing": (lambda: _kernel.moved(np.eye(4), np.array(0.0)), "changes: expected an array of other"),
    "two poses and three changes": (
        lambda: _kernel.moved(np.zeros((2, 4, 4)), np.zeros((3, 6))),
        "poses: expected as many of both, or a single one",
    ),
    "two poses and three others": (
        lambda: _kernel.change_between(np.zeros((2, 4, 4)), np.zeros((3, 4, 4))),
        "poses: expected as many of both, or a single one",
    ),
    "a chain of no frames": (lambda: frames(count=0), "diagonal: expected at least one frame"),
    "a chain with a link too many": (
        lambda: frames(beside=np.zeros((2, 3, 3))),
        r"beside: expected an array \(1, 3, 3\)",
    ),
    "a chain of other unknowns": (lambda: frames(right=np.zeros((2, 4, 1))), r"right: expected an array \(2, 3, N\)"),
    "a chain of nothing": (
        lambda: frames(diagonal=np.zeros((2, 3, 3))),
        "equations: expected finite ones with a solution",
    ),
    "more known than there are unknowns": (
        lambda: _kernel.eliminate_last(np.zeros((1, 2, 2)), np.zeros((1, 2)), np.eye(3)),
        "known: expected at most as many unknowns as the terms have",
    ),
    "unknowns of which nothing is known": (
        lambda: _kernel.eliminate_last(np.zeros((1, 2, 2)), np.zeros((1, 2)), np.zeros((1, 1))),
        "equations: expected finite ones with a solution",
    ),
    "stretches of points that are not finite": (
        lambda: _kernel.straight_stretches(PIXELS + np.nan, PIXELS, 1.0, 1.0, 1.0, 1.0),
        "outline and corners: expected finite numbers",
    ),
    "corners of three numbers": (
        lambda: _kernel.straight_stretches(PIXELS, np.zeros((2, 3)), 1.0, 1.0, 1.0, 1.0),
        r"corners: expected an array \(N, 2\)",
    ),
    "derivatives beside the image": (
        lambda: _kernel.sobel_at(IMAGE, np.array([[8, 0]])),
        "pixels: expected some of the image's",
    ),
    "normals of other points": (
        lambda: straight(normals=np.zeros((1, 2))),
        r"normals: expected an array \(40, 2\), got \(1, 2\)",
    ),
    "a line of two numbers": (lambda: straight(lines=np.zeros((1, 2))), r"lines: expected an array \(N, 3\)"),
    "a contour that is not finite": (
        lambda: straight(points=np.full((40, 2), np.nan)),
        "contour and lines: expected finite numbers",
    ),
    "no stride": (lambda: of_shared(stride=0), "stride: expected a positive number"),
    "no view": (lambda: of_shared(views=0), "views: expected a positive number"),
    "axes of another number": (lambda: of_shared(axes=[]), "compared: expected as many as axes"),
    "comparisons of half a pose": (lambda: of_shared(views=2), "compared: expected as many as axes"),
    "displacements of other points": (lambda: of_shared(more=[np.zeros((1, 2))]), "more: expected an array"),
    "offsets of other points": (lambda: of_shared(offsets=[np.zeros(1)]), "offsets: expected an array"),
    "errors of which nothing is known": (
        lambda: of_shared(deviations=[[np.inf] * 4]),
        "equations: expected finite ones with a solution",
    ),
    "nodes of no distance": (lambda: _kernel.Sharing(None, 0.0, 4), "nodes: expected a positive number"),
    "an axis of the shaft without direction": (
        lambda: _kernel.Sharing(np.zeros((1, 3)), 0.01, 4),
        r"shaft: expected an array \(2, 3\), got \(1, 3\)",
    ),
    "shared errors of links below 0": (
        lambda: shared_errors(link=np.array([0, -1])),
        "link: expected numbers of links",
    ),
    "shared errors of other normals": (lambda: shared_errors(normals=np.ones((1, 2))), "normals: expected an array"),
    "shared errors of endless points": (
        lambda: shared_errors(points=np.full((2, 3), np.inf)),
        "points: expected finite numbers",
    ),
    "shared errors of a shaft without end": (
        lambda: shared_errors(points=np.array([[0.0, 0, 0], [0, 0, 1e9]])),
        "points: expected a shorter shaft",
    ),
    "a contour of another size": (lambda: contour(mask=np.zeros((2, 2), dtype=bool)), "mask: expected an array"),
    "weights of another size": (lambda: contour(weight=IMAGE[:1]), "weight: expected an array"),
    "a contour without reach": (lambda: contour_errors(reach=0), "reach: expected a positive number"),
    "errors of no length": (lambda: contour_errors(length=0.0), "errors: expected positive numbers"),
    "errors that are correlated fully": (lambda: contour_errors(correlated=1.0), "correlated: expected 0 to 1"),
    "coverage of no width": (lambda: comparison().coverage(0), "width: expected that of the images"),
    "coverage of another width": (lambda: comparison().coverage(3), "width: expected that of the images"),
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


def test_rays_of_all_poses_are_traced_together_and_decide() -> None:
    asked = []

    def trace(link: int, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        asked.append((link, origins.shape, directions.shape))
        return np.ones(len(origins), dtype=np.bool_)

    far = _kernel.Mesh([(10 * VERTICES - [0.05, 0.05, 0], FACES)])
    one, two = far.masks(CAMERA, LINKS, 2, trace), far.masks(CAMERA, np.concatenate([LINKS, LINKS]), 2, trace)
    np.testing.assert_array_equal(one, far.masks(CAMERA, LINKS, 2, None))
    np.testing.assert_array_equal(two, np.concatenate([one, one]))
    (first, rays, _), (second, *both) = asked
    assert first == second == 0
    assert rays[0] > 0
    assert both == [(2 * rays[0], 3)] * 2
    np.testing.assert_array_equal(far.masks(CAMERA, LINKS, 2, lambda _, rays, __: np.zeros(len(rays), np.bool_)), 0)


def test_an_exception_of_tracing_is_raised() -> None:
    def trace(*_: Any) -> np.ndarray:
        raise KeyError("no")

    with pytest.raises(KeyError, match="no"):
        mesh().coverage(CAMERA, LINKS, 2, 1, trace)


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


def test_a_minimum_is_that_of_linear_equations() -> None:
    rng = np.random.default_rng(1)
    root = rng.standard_normal((4, 9, 9))
    information, slope = root @ root.swapaxes(1, 2), rng.standard_normal((4, 9))
    found = minimum(compared=[], weight=np.ones(4), information=information, slope=slope, iterations=1)
    np.testing.assert_allclose(found, -np.linalg.solve(information, slope[:, :, None])[:, :, 0], rtol=1e-6)


def test_a_minimum_moves_no_point_too_far() -> None:
    one = comparison()
    slope = np.full((1, 9), 1e6)
    free, held = (minimum(slope=slope, farthest=far, iterations=1) for far in (np.inf, 0.5))
    np.testing.assert_allclose(held / free, np.full((1, 9), (held / free)[0, 0]))
    assert np.abs(one.jacobian @ held[0]).max() == pytest.approx(0.5)


def test_a_line_is_fitted_to_the_majority_of_the_points_near_it() -> None:
    ((line, index, sigma),) = straight()
    np.testing.assert_allclose(line, np.array([-0.1, 1, -3]) / np.hypot(0.1, 1), atol=0.02)
    assert sigma == pytest.approx(0.3)
    np.testing.assert_array_equal(np.sort(index), [k for k in range(40) if k % 8])


def test_a_line_has_the_longest_stretch_without_a_gap() -> None:
    ((_, index, _),) = straight(gap=1.5, iterations=0, near=1e3)
    assert len(index) == 40
    points = np.column_stack([np.r_[0.0:10.0, 30.0:60.0], np.zeros(40)])
    ((_, index, _),) = straight(points=points, normals=np.tile([0.0, 1.0], (40, 1)), lines=np.eye(3)[1:2], gap=5.0)
    np.testing.assert_array_equal(np.sort(index), np.arange(10, 40))


def test_too_few_points_leave_a_line_as_it_is() -> None:
    given = np.array([[0.0, 1.0, -50.0]])
    ((line, index, _),) = straight(lines=given)
    np.testing.assert_array_equal(line, given[0])
    assert len(index) == 0


@pytest.mark.parametrize("share", [0.02, 0.5, 0.999])
def test_distances_at_pixels_are_those_of_all_pairs(share: float) -> None:
    mask = np.random.default_rng(2).uniform(size=(19, 31)) < share
    places = np.stack(np.indices(mask.shape), axis=-1).reshape(-1, 2)
    squares = ((places[:, None] - places) ** 2).sum(axis=2)
    squares[mask.ravel()[:, None] == mask.ravel()] = 10**6
    expected = np.where(mask.ravel(), -1, 1) * (np.sqrt(squares.min(axis=1)) - 0.5)
    pixels = places[:, ::-1].astype(np.float64)
    np.testing.assert_array_equal(_kernel.signed_distances(mask, pixels, 1000.0), expected)
    np.testing.assert_array_equal(_kernel.signed_distances(mask, pixels, 2.0), np.clip(expected, -1.5, 1.5))


def test_a_full_mask_has_the_largest_distance_everywhere() -> None:
    mask = np.ones((4, 5), dtype=np.bool_)
    np.testing.assert_array_equal(_kernel.signed_distances(mask, 1.3 * PIXELS, 30.0), [-29.5, -29.5])


def test_derivatives_at_pixels_are_those_of_the_filtered_image() -> None:
    image = np.random.default_rng(3).uniform(size=(7, 9)).astype(np.float32)
    pixels = np.array([[0, 0], [8, 6], [4, 3], [8, 2]])
    expected = [cv2.Sobel(image, cv2.CV_64F, *axis, borderType=cv2.BORDER_REPLICATE) / 8 for axis in ((1, 0), (0, 1))]
    found = _kernel.sobel_at(image, pixels)
    np.testing.assert_allclose(
        found, np.stack([part[pixels[:, 1], pixels[:, 0]] for part in expected], axis=1), rtol=1e-6
    )


@pytest.mark.parametrize("count", [1, 5])
def test_a_chain_of_frames_is_eliminated_as_its_dense_system(count: int) -> None:
    rng = np.random.default_rng(count)
    parts = rng.standard_normal((2 * count - 1, 3, 3))
    diagonal, beside = parts[:count] @ parts[:count].swapaxes(1, 2) + 9 * np.eye(3), parts[count:]
    dense, right = np.zeros((3 * count, 3 * count)), rng.standard_normal((count, 3, 2))
    for k in range(count):
        dense[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = diagonal[k]
    for k in range(count - 1):
        dense[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6] = beside[k]
        dense[3 * k + 3 : 3 * k + 6, 3 * k : 3 * k + 3] = beside[k].T
    inverses, left = _kernel.eliminate_chain(diagonal, beside, right)
    np.testing.assert_allclose(inverses[-1], np.linalg.inv(dense)[-3:, -3:], atol=1e-12)
    np.testing.assert_allclose(inverses[-1] @ left[-1], np.linalg.solve(dense, right.reshape(-1, 2))[-3:], atol=1e-12)
    np.testing.assert_array_equal(frames(right=right[:1].repeat(2, axis=0))[1], right[:1].repeat(2, axis=0))
