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
        decide: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> NDArray[numpy.float64]: ...
    def masks(
        self,
        camera: Camera,
        camera_from_link: NDArray[numpy.float64],
        threads: int,
        decide: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> NDArray[numpy.bool_]: ...
    def coverage(
        self,
        camera: Camera,
        camera_from_link: NDArray[numpy.float64],
        lines_per_pixel: int,
        threads: int,
        decide: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> NDArray[numpy.float32]: ...
    def outlines(
        self,
        camera: Camera,
        camera_from_link: NDArray[numpy.float64],
        lines_per_pixel: int,
        with_coverage: bool,
        threads: int,
        decide: Callable[..., NDArray[numpy.bool_]] | None,
    ) -> tuple[
        NDArray[numpy.float32] | None,
        NDArray[numpy.int64],
        NDArray[numpy.int64],
        NDArray[numpy.float64],
        NDArray[numpy.float64],
        NDArray[numpy.float64],
    ]: ...

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
def cauchy_losses(
    images: Sequence[NDArray[numpy.float32]],
    target: NDArray[numpy.float32],
    weight: NDArray[numpy.float32],
    cauchy: float,
) -> NDArray[numpy.float64]: ...
def sample_profiles(
    images: Sequence[NDArray[numpy.float32]],
    target: NDArray[numpy.float32],
    weight: NDArray[numpy.float32],
    begin: NDArray[numpy.int64],
    pixels: NDArray[numpy.float64],
    normals: NDArray[numpy.float64],
    reach: int,
) -> tuple[NDArray[numpy.float32], NDArray[numpy.float32]]: ...
def normal_equations(
    begin: NDArray[numpy.int64],
    residual: NDArray[numpy.float32],
    weight: NDArray[numpy.float32],
    jacobian: NDArray[numpy.float64],
    density: NDArray[numpy.float64],
    cauchy: float,
    change: NDArray[numpy.float64],
) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]: ...
