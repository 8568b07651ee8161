"""The counter-based generator against the reference outputs of splitmix64, and its distributions."""

import numpy as np
from scipy import stats

from deltasafe.compute.counter_rng import normal_pair, segment_key, splitmix64, uniform


def test_splitmix64_gives_the_reference_outputs() -> None:
    """Counter n of a key is output n of the sequential generator seeded with the key (Vigna 2015)."""
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431]
    assert [int(splitmix64(np.uint64(1234567), n)) for n in range(1, 5)] == expected
    assert int(splitmix64(np.uint64(0), 1)) == 0xE220A8397B1DCDAF


def test_draws_follow_their_distributions() -> None:
    key = np.uint64(7)
    uniforms = np.array([uniform(key, n) for n in range(4000)])
    normals = np.array([normal_pair(key, 2 * n) for n in range(2000)])
    assert (uniforms >= 0).all()
    assert (uniforms < 1).all()
    assert stats.kstest(uniforms, "uniform").pvalue > 0.001
    assert stats.kstest(normals.ravel(), "norm").pvalue > 0.001
    assert abs(np.corrcoef(normals.T)[0, 1]) < 0.1


def test_segment_keys_depend_on_seed_and_direction() -> None:
    start, end = (0.1, 0.2, 0.3, 0.4), (0.2, 0.2, 0.3, 0.4)
    keys = {
        int(segment_key(np.uint64(seed), first, second))
        for seed in (0, 1)
        for first, second in ((start, end), (end, start), (start, start))
    }
    assert len(keys) == 6
