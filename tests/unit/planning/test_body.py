"""The tool body: distances against closed forms and a search, its covers, and its samples."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree

from deltasafe.errors import SettingsError
from deltasafe.planning import ToolBody
from deltasafe.planning.disc_cover import bounding_balls, disc_cover, distance_to_ellipse

BODIES = [
    ToolBody(),
    ToolBody(0.04, 0.02, 0.004, 0.004, 0.1),
    ToolBody(0.015, 0.03, 0.012),
    ToolBody(0.02, 0.02, 0.01),
]


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(0.01, 0.05), st.floats(0.01, 0.05))
def test_distance_to_ellipse_equals_a_numeric_search(x: float, y: float, a: float, b: float) -> None:
    distance_m = distance_to_ellipse(np.array([[x, y]]), a, b)[0]
    if (x / a) ** 2 + (y / b) ** 2 <= 1:
        assert distance_m == 0
        return
    angles = np.linspace(0, 2 * np.pi, 721)
    best = angles[np.hypot(a * np.cos(angles) - x, b * np.sin(angles) - y).argmin()]
    found = minimize_scalar(
        lambda t: np.hypot(a * np.cos(t) - x, b * np.sin(t) - y),
        bounds=(best - 0.01, best + 0.01),
        method="bounded",
        options={"xatol": 1e-12},
    )
    assert distance_m == pytest.approx(found.fun, abs=1e-7)


def test_distance_to_body_equals_closed_form() -> None:
    body = ToolBody()
    points = np.array(
        [[0, 0, 0], [0.04, 0, 0], [0, 0.02, 0], [0.02, 0, 0.009], [0.01, 0, 0.1], [0, 0, 0.26], [0.033, 0, 0.009]]
    )
    np.testing.assert_allclose(body.distance_m(points), [0, 0.01, 0.005, 0.004, 0.005, 0.01, 0.005], atol=1e-12)


@pytest.mark.parametrize("body", BODIES)
def test_disc_cover_contains_the_disc_and_is_tight(body: ToolBody) -> None:
    centers, radius_m = body.disc_cover
    disc = ToolBody(*[getattr(body, n) for n in ("semi_axis_x_m", "semi_axis_y_m", "thickness_m")], 1e-4, 2e-4)
    rng = np.random.default_rng(0)
    points = disc.samples(0.0, 4000, 1)
    angle = rng.uniform(0, 2 * np.pi, 2000)
    rim = np.column_stack([body.semi_axis_x_m * np.cos(angle), body.semi_axis_y_m * np.sin(angle)])
    edge = np.column_stack([rim, rng.choice([-1, 1], 2000) * body.thickness_m / 2])
    for part in (points, edge):
        nearest = np.linalg.norm(part[:, None] - centers[None], axis=2).min(axis=1)
        assert nearest.max() <= radius_m + 1e-12
    direction = rng.normal(size=(300, 3))
    surface = centers[:, None] + radius_m * (direction / np.linalg.norm(direction, axis=1)[:, None])[None]
    assert body.distance_m(surface.reshape(-1, 3)).max() < 0.0025


@pytest.mark.parametrize("body", BODIES)
def test_bounding_balls_contain_the_disc_and_are_tight_in_its_plane(body: ToolBody) -> None:
    balls = body.bounding_balls
    angle = np.linspace(0, 2 * np.pi, 2001)
    rim = np.column_stack([body.semi_axis_x_m * np.cos(angle), body.semi_axis_y_m * np.sin(angle)])
    disc = np.concatenate([rim * factor for factor in np.linspace(0, 1, 41)])
    points = np.column_stack([disc, np.full(len(disc), body.thickness_m / 2)])
    assert (np.linalg.norm(points[:, None] - balls[:, :3], axis=2) - balls[:, 3]).min(axis=1).max() <= 1e-12
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    edges = (balls[:, None, :3] + balls[:, None, 3:] * circle).reshape(-1, 3)
    assert body.distance_m(edges).max() < 0.0025
    assert len(balls) <= 25


def test_zero_shaft_length_means_no_shaft() -> None:
    disc = ToolBody(0.04, 0.02, 0.002, shaft_length_m=0.0)
    assert disc.distance_m(np.array([[0.0, 0.0, 0.1]]))[0] == pytest.approx(0.099)
    samples = disc.samples(0.003, 5000, 0)
    assert np.abs(samples[:, 2]).max() <= 0.004
    with pytest.raises(SettingsError, match="shaft_length_m"):
        ToolBody(shaft_length_m=-0.1)


@pytest.mark.parametrize("margin_m", [0.0, 0.0055])
def test_samples_are_uniform_on_the_enlarged_body(margin_m: float) -> None:
    """Fractions of the samples below planes, compared with an independent count of lattice points."""
    body = ToolBody(shaft_length_m=0.05)
    samples = body.samples(margin_m, 40000, seed=3)
    assert body.distance_m(samples).max() <= margin_m
    axes = [np.arange(-40, 40) * 0.001, np.arange(-30, 30) * 0.001, np.arange(-30, 120) * 0.0005]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    lattice = lattice + np.array([0.0005, 0.0005, 0.00025])
    lattice = lattice[body.distance_m(lattice) <= margin_m]
    for axis, cut in ((0, 0.015), (1, -0.005), (2, 0.0), (2, 0.008), (2, 0.03)):
        expected = (lattice[:, axis] < cut).mean()
        # five standard deviations, and the resolution of the lattice
        assert (samples[:, axis] < cut).mean() == pytest.approx(expected, abs=5 * 0.5 / 200 + 0.008)


def test_samples_depend_on_the_seed_alone() -> None:
    assert (ToolBody().samples(0.001, 50, 7) == ToolBody().samples(0.001, 50, 7)).all()
    assert (ToolBody().samples(0.001, 50, 7) != ToolBody().samples(0.001, 50, 8)).any()
    with pytest.raises(SettingsError, match="margin_m"):
        ToolBody().samples(-1.0, 5, 0)


@pytest.mark.parametrize("semi_axes_m", [(0.04, 0.003), (0.025, 0.001), (0.001, 0.15)])
def test_covers_of_slender_discs_hold_them_in_bounded_memory(semi_axes_m: tuple[float, float]) -> None:
    """B13: the grids grew with the ratio of the semi-axes; 25 x 1 mm raised MemoryError, 40 x 3 mm took 85 s."""
    a, b = semi_axes_m
    disc_cover.cache_clear()
    bounding_balls.cache_clear()
    tracemalloc.start()
    try:
        (centers, radius_m), balls = disc_cover(a, b, 0.02), bounding_balls(a, b, 0.02)
        assert tracemalloc.get_traced_memory()[1] < 600e6
    finally:
        tracemalloc.stop()
    assert len(centers) < 10_000
    angle, share = np.random.default_rng(0).uniform(0, 1, (2, 2000))
    flat = np.sqrt(share)[:, None] * np.column_stack([a * np.cos(2 * np.pi * angle), b * np.sin(2 * np.pi * angle)])
    points = np.column_stack([flat, np.full(len(flat), 0.01)])
    assert cKDTree(centers).query(points)[0].max() <= radius_m + 1e-12
    assert (np.linalg.norm(points[:, None] - balls[:, :3], axis=2) - balls[:, 3]).min(axis=1).max() <= 1e-12
