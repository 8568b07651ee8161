"""An ensemble shared by threads, forked and spawned processes, pickled and copied."""

import concurrent.futures
import copy
import multiprocessing
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from deltasafe.perception.inference.ensemble import Ensemble
from tests.unit.perception.backend_cases import INFERENCE, NETWORK, freeze, image, installed, network

BACKENDS = ("torch", "onnxruntime", "openvino")


@pytest.fixture(scope="module")
def frozen(tmp_path_factory):
    return freeze(tmp_path_factory.mktemp("artifacts"))


@pytest.mark.parametrize("backend", BACKENDS)
def test_threads_get_predictions_of_their_own_images(frozen, backend):
    images = [image(48, 64, seed) for seed in range(64)]
    shared = load_ensemble(frozen, backend=installed(backend))
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        predictions = list(pool.map(shared.p_occupied, images))  # the first use is concurrent as well
    expected = [shared.p_occupied(rgb) for rgb in images]
    assert np.abs(expected[0] - expected[1]).max() > 1e-3
    assert all(np.array_equal(given, one) for given, one in zip(predictions, expected, strict=True))


def test_threads_share_one_backend(frozen):
    shared = load_ensemble(frozen)
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        backends = list(pool.map(lambda _: shared.backend, range(64)))
    assert len({id(each) for each in backends}) == 1


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    "duplicate",
    [lambda each: pickle.loads(pickle.dumps(each)), copy.deepcopy, copy.copy],
    ids=["pickle", "deep", "copy"],
)
def test_copy_predicts_the_same_before_and_after_first_use(frozen, backend, duplicate):
    original = load_ensemble(frozen, backend=installed(backend))
    before = duplicate(original)
    expected = original.p_occupied(image(50, 60))
    for each in (before, duplicate(original)):
        assert np.array_equal(each.p_occupied(image(50, 60)), expected)
        assert each.backend.name == backend


def test_deepcopy_after_use_has_its_own_weights():
    original = Ensemble([network(NETWORK, 0)], INFERENCE)
    expected = original.p_occupied(image(50, 60))
    duplicate = copy.deepcopy(original)
    for parameter in original.members.parameters():
        parameter.data.zero_()
    assert np.array_equal(duplicate.p_occupied(image(50, 60)), expected)


@pytest.mark.parametrize("backend", BACKENDS)
def test_pickled_ensemble_predicts_in_spawned_process(frozen, backend):
    original = load_ensemble(frozen, backend=installed(backend))
    expected = original.p_occupied(image(50, 60))
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
        given = pool.submit(original.p_occupied, image(50, 60)).result()
    assert np.abs(given - expected).max() < 1e-5


def test_working_directory_may_change_before_first_use(frozen, monkeypatch, tmp_path):
    monkeypatch.chdir(frozen.parent)
    ensemble = load_ensemble(frozen.name)
    monkeypatch.chdir(tmp_path)
    assert ensemble.p_occupied(image(50, 60)).shape == (50, 60)


FORKS = """
import os, signal, sys
import numpy as np, torch
from deltasafe.perception.artifact.frozen_ensemble import load_ensemble

folder, backend, used, loads_again = sys.argv[1], sys.argv[2], sys.argv[3] == "used", sys.argv[4] == "again"
torch.set_num_threads(2)
rgb = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
ensemble = load_ensemble(folder, backend=backend)
expected = load_ensemble(folder, backend=backend).p_occupied(rgb)
if used:
    ensemble.p_occupied(rgb)
child = os.fork()
if child == 0:
    signal.alarm(240)  # a child that hangs is killed
    status = 1
    try:
        inherited = load_ensemble(folder, backend=backend) if loads_again else ensemble
        status = 0 if np.abs(inherited.p_occupied(rgb) - expected).max() < 1e-5 else 2
    finally:
        os._exit(status)
status = os.waitpid(child, 0)[1]
assert np.array_equal(ensemble.p_occupied(rgb), expected), "the parent's prediction changed"
assert torch.get_num_threads() == 2
os._exit(status != 0)
"""


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("used", "loads"), [("used", "inherited"), ("used", "again"), ("unused", "inherited")])
def test_forked_process_predicts(frozen, backend, used, loads):
    # the deadlock needs two threads; the test suite itself runs with one
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    command = [sys.executable, "-c", FORKS, str(frozen), installed(backend), used, loads]
    subprocess.run(command, check=True, env=environment)


def test_fork_without_ensemble_keeps_number_of_threads():
    program = """
import os, torch, deltasafe.perception.inference.ensemble
torch.set_num_threads(2)
child = os.fork()
if child == 0:
    os._exit(torch.get_num_threads() != 2)
os._exit(os.waitpid(child, 0)[1] != 0)
"""
    subprocess.run([sys.executable, "-c", program], check=True)
