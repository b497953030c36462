"""Recovery of the shaft's axis from its two projected edges and its radius."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from dvrk_cmaes.evidence.shaft_edges import shaft_axis
from dvrk_cmaes.geometry import project_cylinder


@given(
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.floats(0.04, 0.2),
    st.floats(0.1, np.pi - 0.1),
    st.floats(-np.pi, np.pi),
    st.floats(0.001, 0.006),
)
def test_axis_of_projected_cylinder_is_recovered(
    x: float, y: float, z: float, polar: float, azimuth: float, radius: float
) -> None:
    point = np.array([x, y, z])
    direction = np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    nearest = point - (point @ direction) * direction
    assume(np.linalg.norm(nearest) > 1.5 * radius)  # otherwise the camera is nearly inside the cylinder
    planes = project_cylinder(point, direction, radius)
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    planes *= -np.sign(planes @ nearest)[:, None]  # both half-spaces contain the axis
    found_direction, found_point = shaft_axis(planes, radius)
    np.testing.assert_allclose(abs(found_direction @ direction), 1, atol=1e-9)
    np.testing.assert_allclose(found_point, nearest, atol=1e-9)
