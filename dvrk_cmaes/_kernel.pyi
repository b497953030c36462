from collections.abc import Callable, Sequence

import numpy
from numpy.typing import NDArray

class Camera:
    def __init__(
        self,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        model: str,
        coefficients: Sequence[float],
        radius: float,
    ) -> None: ...

class Chain:
    def __init__(
        self,
        parents: Sequence[int],
        drivers: Sequence[int],
        sliding: Sequence[bool],
        multipliers: Sequence[float],
        offsets: Sequence[float],
        terms: NDArray[numpy.float64],
    ) -> None: ...
    def forward(
        self, values: NDArray[numpy.float64], selected: Sequence[int], derivatives: bool
    ) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64] | None]: ...

class Mesh:
    def __init__(self, links: Sequence[tuple[NDArray[numpy.float64], NDArray[numpy.int32]]]) -> None: ...
    @property
    def edges(self) -> int: ...
    def sums(
        self,
        camera: Camera,
        camera_from_link: NDArray[numpy.float64],
        table: NDArray[numpy.float64],
        lines_per_pixel: int,
        to_pixel: bool,
        threads: int,
        trace: Callable[..., NDArray[numpy.bool_]] | None,
        part: Sequence[int] | None = None,
    ) -> NDArray[numpy.float64]: ...
    def masks(
        self,
        camera: Camera,
        camera_from_link: NDArray[numpy.float64],
        threads: int,
        trace: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> NDArray[numpy.bool_]: ...
    def coverage(
        self,
        camera: Camera,
        camera_from_link: NDArray[numpy.float64],
        lines_per_pixel: int,
        threads: int,
        trace: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> NDArray[numpy.float32]: ...
    def outlines(
        self,
        camera: Camera,
        camera_from_link: NDArray[numpy.float64],
        lines_per_pixel: int,
        threads: int,
        trace: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> tuple[
        NDArray[numpy.int64],
        NDArray[numpy.int64],
        NDArray[numpy.float64],
        NDArray[numpy.float64],
        NDArray[numpy.float64],
    ]: ...
    def compare(
        self,
        camera: Camera,
        target: Target,
        camera_from_root: NDArray[numpy.float64],
        root_from_link: NDArray[numpy.float64],
        by_joint: NDArray[numpy.float64] | None,
        camera_from_link: NDArray[numpy.float64],
        lines_per_pixel: int,
        cauchy: Sequence[float],
        threads: int,
        trace: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> list[Comparison]: ...
    def difference(
        self,
        camera: Camera,
        compared: Sequence[Comparison],
        camera_from_link: NDArray[numpy.float64],
        steps: NDArray[numpy.float64],
        lines_per_pixel: int,
        threads: int,
        trace: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> None: ...
    def contours(
        self,
        camera: Camera,
        mask: NDArray[numpy.bool_],
        weight: NDArray[numpy.float32],
        camera_from_root: NDArray[numpy.float64],
        root_from_link: NDArray[numpy.float64],
        by_joint: NDArray[numpy.float64],
        camera_from_link: NDArray[numpy.float64],
        errors: ContourErrors,
        threads: int,
        trace: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.float64]]: ...

def move_points(
    camera: Camera,
    begin: NDArray[numpy.int64],
    link: NDArray[numpy.int64],
    points: NDArray[numpy.float64],
    directions: NDArray[numpy.float64],
    camera_from_root: NDArray[numpy.float64],
    root_from_link: NDArray[numpy.float64],
    by_joint: NDArray[numpy.float64],
) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.float64]]: ...

class Target:
    def __init__(
        self, mask: NDArray[numpy.float32], weight: NDArray[numpy.float32], taps: Sequence[float], reach: int
    ) -> None: ...
    @property
    def image(self) -> NDArray[numpy.float32]: ...

class ContourErrors:
    def __init__(
        self,
        reach: int,
        least: int,
        normal_median: float,
        least_sigma: float,
        clip: float,
        correlated: float,
        length: float,
        farthest: float,
        grid: float,
        inflation: float,
    ) -> None: ...

class Sharing:
    def __init__(self, shaft: NDArray[numpy.float64] | None, nodes: float, least: int) -> None: ...

class Shown:
    def __init__(self, usual: float, factor: float, most: float) -> None: ...

class Comparison:
    @property
    def losses(self) -> list[float]: ...
    @property
    def outlined(self) -> bool: ...
    @property
    def differenced(self) -> bool: ...
    @property
    def unknowns(self) -> int: ...
    def coverage(self, width: int) -> NDArray[numpy.float32]: ...
    @property
    def link(self) -> NDArray[numpy.int64]: ...
    @property
    def pixels(self) -> NDArray[numpy.float64]: ...
    @property
    def normals(self) -> NDArray[numpy.float64]: ...
    @property
    def points(self) -> NDArray[numpy.float64]: ...
    @property
    def jacobian(self) -> NDArray[numpy.float64]: ...

def normal_equations(
    compared: Sequence[Comparison],
    factors: Sequence[float],
    density: Sequence[float],
    cauchy: float,
    change: NDArray[numpy.float64],
) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]: ...
def shared_errors(
    link: NDArray[numpy.int64],
    normals: NDArray[numpy.float64],
    points: NDArray[numpy.float64],
    axis: Sequence[float],
    deviations: Sequence[float],
    sharing: Sharing,
    offsets: NDArray[numpy.float64] | None,
    shown: Shown,
) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]: ...
def shared_equations(
    compared: Sequence[Comparison],
    factors: Sequence[float],
    density: Sequence[float],
    cauchy: float,
    stride: int,
    axes: Sequence[Sequence[float]],
    deviations: Sequence[Sequence[float]],
    sharing: Sharing,
    more: Sequence[NDArray[numpy.float64]],
    offsets: Sequence[NDArray[numpy.float64]],
    shown: Shown,
    views: int,
) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]: ...
def signed_distances(
    mask: NDArray[numpy.bool_], pixels: NDArray[numpy.float64], farthest: float
) -> NDArray[numpy.float64]: ...
def exp_rotation(vectors: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...
def log_rotation(rotations: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...
def moved(poses: NDArray[numpy.float64], changes: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...
def change_between(poses: NDArray[numpy.float64], others: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...
def eliminate_chain(
    diagonal: NDArray[numpy.float64], beside: NDArray[numpy.float64], right: NDArray[numpy.float64]
) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]: ...
def eliminate_last(
    information: NDArray[numpy.float64], slope: NDArray[numpy.float64], known: NDArray[numpy.float64]
) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]: ...
def fit_lines(
    points: NDArray[numpy.float64],
    normals: NDArray[numpy.float64],
    lines: NDArray[numpy.float64],
    sigma: float,
    near: float,
    facing: float,
    gap: float,
    least_sigma: float,
    reach: float,
    least_reach: float,
    normal_median: float,
    iterations: int,
    least: int,
) -> list[tuple[NDArray[numpy.float64], NDArray[numpy.int64], float]]: ...
def straight_stretches(
    outline: NDArray[numpy.float64],
    corners: NDArray[numpy.float64],
    band: float,
    gap: float,
    shortest: float,
    side: float,
) -> list[tuple[NDArray[numpy.int64], NDArray[numpy.float64]]]: ...
def sobel_at(image: NDArray[numpy.float32], pixels: NDArray[numpy.int64]) -> NDArray[numpy.float64]: ...
def line_support(
    points: NDArray[numpy.float64],
    normals: NDArray[numpy.float64],
    lines: NDArray[numpy.float64],
    sigma: float,
    facing: float,
) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]: ...
def minimise(
    compared: Sequence[Comparison],
    factors: Sequence[float],
    density: Sequence[float],
    cauchy: float,
    weight: NDArray[numpy.float64],
    information: NDArray[numpy.float64],
    slope: NDArray[numpy.float64],
    damping: NDArray[numpy.float64] | None,
    iterations: int,
    solved: float,
    least: Sequence[float],
    farthest: float,
) -> NDArray[numpy.float64]: ...
