"""Noise and curves: range, continuity, pinned values, distance against brute force."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from generator.noise import (
    POINTS_PER_SEGMENT,
    catmull_rom,
    distance_to_polyline,
    fractal_noise,
    smoothstep,
    value_noise,
)


@given(st.integers(0, 2**20))
def test_noise_is_bounded_continuous_and_deterministic(seed):
    points = np.random.default_rng(seed).uniform(-1000, 1000, (200, 3))
    noise = value_noise(points, seed)
    assert np.abs(noise).max() <= 1
    assert np.abs(value_noise(points + 1e-6, seed) - noise).max() < 1e-4
    assert np.array_equal(value_noise(points, seed), noise)
    assert not np.array_equal(value_noise(points, seed + 1), noise)
    assert np.abs(fractal_noise(points, seed, 4)).max() <= 1


def test_noise_has_pinned_values():
    points = np.array([[0.0, 0.0, 0.0], [1.25, -3.5, 7.75], [-100.5, 20.25, 3.0]])
    pinned = [0.6239871824216068, -0.21958603076406571, -0.3599227154383154]
    assert value_noise(points, 5) == pytest.approx(pinned, abs=1e-12)


def test_noise_is_continuous_at_lattice_points():
    point = np.array([[3.0, -4.0, 9.0]])
    assert value_noise(point - 1e-9, 1) == pytest.approx(value_noise(point + 1e-9, 1), abs=1e-7)


def test_smoothstep_with_swapped_ends_is_mirrored():
    x = np.linspace(-1, 2, 31)
    assert np.allclose(smoothstep(0, 1, x) + smoothstep(1, 0, x), 1)
    assert smoothstep(0, 1, np.array([-1, 0.5, 2])) == pytest.approx([0, 0.5, 1])


def test_distance_to_polyline_matches_densely_sampled_line():
    rng = np.random.default_rng(0)
    line, points = rng.uniform(-1, 1, (5, 2)), rng.uniform(-2, 2, (100, 2))
    dense = np.concatenate([np.linspace(a, b, 2001) for a, b in itertools.pairwise(line)])
    brute = np.linalg.norm(points[:, None] - dense, axis=2).min(axis=1)
    distance, parameter = distance_to_polyline(points, line)
    assert distance == pytest.approx(brute, abs=1e-3)
    assert parameter.min() >= 0
    assert parameter.max() <= 1
    assert distance_to_polyline(line, line)[1] == pytest.approx(np.linspace(0, 1, 5))


def test_spline_passes_through_its_knots():
    knots = np.random.default_rng(1).normal(size=(6, 2))
    assert np.allclose(catmull_rom(knots)[::POINTS_PER_SEGMENT], knots)
