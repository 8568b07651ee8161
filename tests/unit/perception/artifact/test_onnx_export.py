"""The exported ONNX program against the networks in torch."""

import collections
import dataclasses

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from deltasafe.perception.artifact.onnx_export import export_onnx
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.settings import NetworkSettings
from deltasafe.perception.training.network import build_network
from tests.unit.perception.backend_cases import INFERENCE, NETWORK, freeze, image, network


@pytest.fixture(scope="module")
def frozen(tmp_path_factory):
    return freeze(tmp_path_factory.mktemp("artifacts"))


def export(networks, folder):
    ensemble = Ensemble(networks, INFERENCE)
    export_onnx(ensemble, folder / "ensemble.onnx")
    return ensemble, session_of(folder)


def session_of(folder):
    return onnxruntime.InferenceSession(folder / "ensemble.onnx", providers=["CPUExecutionProvider"])


def torch_p_occupied(ensemble, rgb):
    with torch.inference_mode():
        return torch.sigmoid(ensemble.backend.member_logits(rgb)).numpy()


def difference_from_torch(ensemble, session, height, width):
    rgb = image(height, width)[None]
    expected = torch_p_occupied(ensemble, rgb)
    return np.abs(session.run(["member_p_occupied"], {"rgb": rgb})[0] - expected).max()


@pytest.fixture(scope="module")
def default_program(tmp_path_factory):
    networks = [network(NetworkSettings(pretrained=False), seed) for seed in range(2)]
    return export(networks, tmp_path_factory.mktemp("program"))


@given(height=st.integers(1, 150), width=st.integers(1, 150))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_program_agrees_with_torch_at_any_size(default_program, height, width):
    assert difference_from_torch(*default_program, height, width) < 1e-5


@pytest.mark.parametrize("size", [(192, 256), (190, 250), (270, 480), (135, 241)])
def test_program_agrees_with_torch_at_common_sizes(default_program, size):
    assert np.ptp(torch_p_occupied(default_program[0], image(*size)[None])) > 0.1, "probabilities are nearly constant"
    assert difference_from_torch(*default_program, *size) < 2e-5


def test_program_agrees_with_torch_on_smooth_and_noisy_images(default_program):
    ensemble, session = default_program
    sizes = np.random.default_rng(5)
    differences, low, high = [], 1.0, 0.0
    for seed in range(24):
        noise = image(*sizes.integers(20, 200, 2), seed)
        rgb = (noise if seed % 2 else np.sort(noise, axis=1))[None]
        expected = torch_p_occupied(ensemble, rgb)
        differences.append(np.abs(session.run(["member_p_occupied"], {"rgb": rgb})[0] - expected).max())
        low, high = min(low, expected.min()), max(high, expected.max())
    assert max(differences) < 1e-4
    assert high - low > 0.8


@pytest.mark.parametrize(
    "settings",
    [
        NetworkSettings(pretrained=False, pyramid_channels=8, backbone="mobilenet_v3_large"),
        NetworkSettings("deeplabv3", "resnet50", pretrained=False, pyramid_channels=8),
        dataclasses.replace(NETWORK, architecture="deeplabv3"),
    ],
    ids=["mobilenet", "resnet", "deeplabv3"],
)
def test_program_of_every_architecture_agrees_with_torch(settings, tmp_path):
    program = export([network(settings, seed) for seed in range(2)], tmp_path)
    for size in ((48, 64), (96, 32), (45, 70), (1, 1)):
        assert difference_from_torch(*program, *size) < 1e-4


def test_program_predicts_batches_and_applies_temperature(frozen):
    ensemble = load_ensemble(frozen, backend="torch")
    ensemble.settings = dataclasses.replace(INFERENCE, scales=(1.0,))  # the program has one
    batch = np.stack([image(48, 64, seed) for seed in range(3)])
    mean, members = session_of(frozen).run(["p_occupied", "member_p_occupied"], {"rgb": batch})
    for index, rgb in enumerate(batch):
        assert np.abs(mean[index] - ensemble.p_occupied(rgb)).max() < 1e-4
        assert np.abs(members[index] - ensemble.member_p_occupied(rgb)).max() < 1e-4
    assert np.abs(mean - members.mean(axis=1)).max() > 1e-3


def test_bias_that_is_zero_in_traced_member_is_kept_in_another(tmp_path):
    """The optimizer removes biases that are zero; it must do so for each member by itself."""
    networks = [network(NETWORK, seed) for seed in range(2)]
    for member, bias in zip(networks, (0.0, 0.8), strict=True):
        nn.init.constant_(member.decoder[-1].bias, bias)
    assert difference_from_torch(*export(networks, tmp_path), 48, 64) < 1e-4


def test_program_fuses_batch_normalization_and_convolves_before_upsampling(frozen):
    graph = onnx.load(frozen / "ensemble.onnx").graph
    kinds = collections.Counter(node.op_type for node in graph.node)
    assert "BatchNormalization" not in kinds
    n_convolutions = sum(isinstance(module, nn.Conv2d) for module in build_network(NETWORK, 0).modules())
    assert kinds["Conv"] == 3 * (n_convolutions + 1 + 2)  # one is split in two; two make the upsampling matrices
    assert {node.domain for node in graph.node} == {""}, "other runtimes know standard operators only"


def test_program_for_any_size_has_model_version_1(default_program):
    assert default_program[1].get_modelmeta().version == 1


def test_export_is_deterministic(frozen, tmp_path):
    export_onnx(load_ensemble(frozen, backend="torch"), tmp_path / "again.onnx")
    assert (tmp_path / "again.onnx").read_bytes() == (frozen / "ensemble.onnx").read_bytes()
