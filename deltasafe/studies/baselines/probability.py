"""P(collision) with an obstacle at a Gaussian position: the exact value and the bounds of the compared methods.

All functions use the frame of ``ObstacleArrays``: the grown obstacle is the unit ball, the robot's center is w, and
the noise has the covariance diag(spread). Decision 14: poses inside the mean shape are forbidden in any case.
"""

import math

import numpy as np

from deltasafe.compute.numba_cache import compiled

METHODS = ("chance_constraint", "max_probability", "bounding_volume", "exact")
"""Zhu and Alonso-Mora 2019; Park, Park and Manocha 2018; Kamel 2017; and the Gaussian integral itself."""
CHANCE_CONSTRAINT, MAX_PROBABILITY, BOUNDING_VOLUME, EXACT = range(len(METHODS))

JOINT_RISKS = ("each", "boole", "noisy_or")
"""How n obstacles share delta: delta each; delta / n each; or 1 - prod(1 - p_i) <= delta (decision 14)."""
EACH, BOOLE, NOISY_OR = range(len(JOINT_RISKS))

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)
INTEGRATION_SIGMAS = 8.5
"""The normal density is integrated within this many standard deviations."""


@compiled
def collision_probability_of_ball(distance, radius, sigma):  # type: ignore[no-untyped-def]
    """Compute P(|X| <= radius) for X ~ N(mu, sigma^2 I_3) with |mu| = distance: a non-central chi-square with k = 3.

    F(R^2 / sigma^2; 3, distance^2 / sigma^2) in closed form: with a = (R - d) / sigma and b = (R + d) / sigma it is
    Phi(a) - Phi(-b) - (sigma / d) (phi(a) - phi(b)).
    """
    a, b = (radius - distance) / sigma, (radius + distance) / sigma
    shift = distance / sigma
    if shift < 1e-4:  # the limit d -> 0, where the closed form is 0 / 0
        ratio = radius / sigma
        return math.erf(ratio / math.sqrt(2.0)) - math.sqrt(2.0 / math.pi) * ratio * math.exp(-0.5 * ratio * ratio)
    tails = 0.5 * (math.erfc(-a / math.sqrt(2.0)) - math.erfc(b / math.sqrt(2.0)))
    densities = (math.exp(-0.5 * a * a) - math.exp(-0.5 * b * b)) / math.sqrt(2.0 * math.pi)
    return max(tails - densities / shift, 0.0)


@compiled
def risk(kind, numeric, w, spread):  # type: ignore[no-untyped-def]
    """Compute P(collision) by the method ``METHODS[kind]``; inside the mean shape it is 1, except for ``EXACT``."""
    squared = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    if kind == EXACT:
        return _exact(w, spread)
    if squared <= 1.0:
        return 1.0
    if kind == CHANCE_CONSTRAINT:
        return _linearized(w, squared, spread)
    if kind == MAX_PROBABILITY:
        return _max_probability(numeric, w, squared, spread)
    return 0.0


@compiled
def _linearized(w, squared, spread):  # type: ignore[no-untyped-def]
    """Bound by the half space tangent to the ball at its point nearest to w (Zhu and Alonso-Mora 2019, eq. 11)."""
    variance = (w[0] * w[0] * spread[0] + w[1] * w[1] * spread[1] + w[2] * w[2] * spread[2]) / squared
    return 0.5 * math.erfc((math.sqrt(squared) - 1.0) / math.sqrt(2.0 * variance))


@compiled
def _max_probability(numeric, w, squared, spread):  # type: ignore[no-untyped-def]
    """Bound by volume times largest density in the ball (Park, Park and Manocha 2018), clipped at 1."""
    if not numeric and spread[0] == spread[2]:
        least = (math.sqrt(squared) - 1.0) ** 2 / spread[0]
    else:
        least = _least_mahalanobis(w, spread)
    volume = 4.0 / 3.0 * math.pi
    density = math.exp(-0.5 * least) / math.sqrt((2.0 * math.pi) ** 3 * spread[0] * spread[1] * spread[2])
    return min(volume * density, 1.0)


@compiled
def _least_mahalanobis(w, spread):  # type: ignore[no-untyped-def]
    """Minimize (x - w)' diag(spread)^-1 (x - w) over the unit ball, for w outside.

    The minimum is at x = w / (1 + lambda spread), with lambda > 0 such that |x| = 1. Newton's method on 1 / |x| - 1
    converges from the left without overshoot, because that function is concave and almost linear in lambda.
    """
    multiplier = 0.0
    for _ in range(50):
        square, slope = 0.0, 0.0
        for i in range(3):
            below = 1.0 + multiplier * spread[i]
            part = (w[i] / below) ** 2
            square += part
            slope += part * spread[i] / below
        norm = math.sqrt(square)
        step = (norm - 1.0) * square / slope
        multiplier += step
        if abs(step) <= 1e-13 * multiplier:
            break
    least = 0.0
    for i in range(3):
        least += spread[i] * (multiplier * w[i] / (1.0 + multiplier * spread[i])) ** 2
    return least


@compiled
def _exact(w, spread):  # type: ignore[no-untyped-def]
    """Compute P(|w + noise| <= 1): closed form for isotropic noise, else Gauss-Legendre quadrature and erf."""
    if spread[0] == spread[2]:
        distance = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        return collision_probability_of_ball(distance, 1.0, math.sqrt(spread[0]))
    s0, s1, s2 = math.sqrt(spread[0]), math.sqrt(spread[1]), math.sqrt(spread[2])
    total = 0.0
    # substituting x = sin(t), y = cos(t) sin(u) removes the square roots that are not smooth at the rim of the ball
    low, high = _sine_range(w[0], s0, 1.0)
    for i in range(len(_NODES)):
        t = 0.5 * (low + high + (high - low) * _NODES[i])
        x, half = math.sin(t), math.cos(t)
        inner = 0.0
        left, right = _sine_range(w[1], s1, half)
        for j in range(len(_NODES)):
            u = 0.5 * (left + right + (right - left) * _NODES[j])
            y, z = half * math.sin(u), half * math.cos(u)
            across = 0.5 * (
                math.erfc((w[2] - z) / (math.sqrt(2.0) * s2)) - math.erfc((w[2] + z) / (math.sqrt(2.0) * s2))
            )
            inner += _WEIGHTS[j] * z * across * math.exp(-0.5 * ((y - w[1]) / s1) ** 2)
        total += _WEIGHTS[i] * half * math.exp(-0.5 * ((x - w[0]) / s0) ** 2) * inner * 0.5 * (right - left)
    return max(total * 0.5 * (high - low) / (2.0 * math.pi * s0 * s1), 0.0)


@compiled
def _sine_range(mean, sigma, half):  # type: ignore[no-untyped-def]
    """Return the range of angles in which half * sin(angle) lies within ``INTEGRATION_SIGMAS`` of the mean."""
    low = min(max((mean - INTEGRATION_SIGMAS * sigma) / half, -1.0), 1.0)
    high = min(max((mean + INTEGRATION_SIGMAS * sigma) / half, -1.0), 1.0)
    return math.asin(low), math.asin(high)
