"""One ensemble in several threads, in forked and spawned processes, pickled and copied."""

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
def test_threads_get_the_answers_to_their_own_images(frozen, backend):
    images = [image(48, 64, seed) for seed in range(64)]
    shared = load_ensemble(frozen, backend=installed(backend))
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(shared.p_occupied, images))  # the first use is concurrent as well
    expected = [shared.p_occupied(rgb) for rgb in images]
    assert np.abs(expected[0] - expected[1]).max() > 1e-3
    assert all(np.array_equal(answer, one) for answer, one in zip(answers, expected, strict=True))


def test_threads_share_the_engine_that_the_first_one_creates(frozen):
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
def test_a_copy_gives_the_same_answer_before_and_after_first_use(frozen, backend, duplicate):
    original = load_ensemble(frozen, backend=installed(backend))
    before = duplicate(original)
    expected = original.p_occupied(image(50, 60))
    for each in (before, duplicate(original)):
        assert np.array_equal(each.p_occupied(image(50, 60)), expected)
        assert each.backend.name == backend


def test_an_ensemble_that_was_not_frozen_is_copied_after_use():
    original = Ensemble([network(NETWORK, 0)], INFERENCE)
    expected = original.p_occupied(image(50, 60))
    duplicate = copy.deepcopy(original)
    for parameter in original.members.parameters():
        parameter.data.zero_()
    assert np.array_equal(duplicate.p_occupied(image(50, 60)), expected)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_spawned_process_uses_a_pickled_ensemble(frozen, backend):
    original = load_ensemble(frozen, backend=installed(backend))
    expected = original.p_occupied(image(50, 60))
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
        answer = pool.submit(original.p_occupied, image(50, 60)).result()
    assert np.abs(answer - expected).max() < 1e-5


def test_the_working_directory_may_change_before_the_first_use(frozen, monkeypatch, tmp_path):
    monkeypatch.chdir(frozen.parent)
    ensemble = load_ensemble(frozen.name)
    monkeypatch.chdir(tmp_path)
    assert ensemble.p_occupied(image(50, 60)).shape == (50, 60)


FORKS = """
import os, signal, sys
import numpy as np, torch
from deltasafe.perception.artifact.frozen_ensemble import load_ensemble

folder, backend, used, loads_anew = sys.argv[1], sys.argv[2], sys.argv[3] == "used", sys.argv[4] == "anew"
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
        inherited = load_ensemble(folder, backend=backend) if loads_anew else ensemble
        status = 0 if np.abs(inherited.p_occupied(rgb) - expected).max() < 1e-5 else 2
    finally:
        os._exit(status)
status = os.waitpid(child, 0)[1]
assert np.array_equal(ensemble.p_occupied(rgb), expected), "the parent's answer changed"
assert torch.get_num_threads() == 2
os._exit(status != 0)
"""


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("used", "loads"), [("used", "inherited"), ("used", "anew"), ("unused", "inherited")])
def test_a_forked_process_answers(frozen, backend, used, loads):
    # two threads, as the fault needs; the suite itself runs with one
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    command = [sys.executable, "-c", FORKS, str(frozen), installed(backend), used, loads]
    subprocess.run(command, check=True, env=environment)


def test_forking_a_process_without_an_ensemble_leaves_its_threads():
    program = """
import os, torch, deltasafe.perception.inference.ensemble
torch.set_num_threads(2)
child = os.fork()
if child == 0:
    os._exit(torch.get_num_threads() != 2)
os._exit(os.waitpid(child, 0)[1] != 0)
"""
    subprocess.run([sys.executable, "-c", program], check=True)
