import collections
import dataclasses
import pathlib
import shutil

import numpy as np
import onnx
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from deltasafe.errors import ArtifactError, SettingsError
from deltasafe.perception.artifact.frozen_ensemble import golden_difference, load_ensemble
from deltasafe.perception.artifact.onnx_export import export_onnx
from deltasafe.perception.inference.backends import select_backend
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.settings import NetworkSettings
from deltasafe.perception.training.network import build_network
from tests.unit.perception.backend_cases import INFERENCE, NETWORK, freeze, image, installed, network


@pytest.fixture(scope="module")
def frozen(tmp_path_factory):
    return freeze(tmp_path_factory.mktemp("artifacts"))


@pytest.mark.parametrize("backend", ["onnxruntime", "openvino"])
@pytest.mark.parametrize("size", [(48, 64), (1, 1), (17, 300), (300, 40), (240, 320)])
def test_every_engine_agrees_with_torch_on_any_image(frozen, backend, size):
    fast, reference = load_ensemble(frozen, backend=installed(backend)), load_ensemble(frozen, backend="torch")
    assert (fast.backend.name, reference.backend.name) == (backend, "torch")
    rgb = image(*size, seed=1)
    each = reference.member_p_occupied(rgb)
    assert np.ptp(each) > 0 or size == (1, 1)
    assert np.abs(fast.member_p_occupied(rgb) - each).max() < 1e-4
    assert np.abs(fast.p_occupied(rgb) - reference.p_occupied(rgb)).max() < 1e-4
    assert golden_difference(fast) < 1e-4


def test_the_program_agrees_for_any_batch_and_applies_the_temperature(frozen):
    import onnxruntime

    session = onnxruntime.InferenceSession(frozen / "ensemble.onnx", providers=["CPUExecutionProvider"])
    ensemble = load_ensemble(frozen, backend="torch")
    batch = np.stack([image(48, 64, seed) for seed in range(3)])
    mean, each = session.run(["p_occupied", "member_p_occupied"], {"rgb": batch})
    for index, rgb in enumerate(batch):
        assert np.abs(mean[index] - ensemble.p_occupied(rgb)).max() < 1e-4
        assert np.abs(each[index] - ensemble.member_p_occupied(rgb)).max() < 1e-4
    assert np.abs(mean - each.mean(axis=1)).max() > 1e-3


@pytest.fixture(scope="module")
def default_program(tmp_path_factory):
    import onnxruntime

    ensemble = Ensemble([network(NetworkSettings(pretrained=False), seed) for seed in range(2)], INFERENCE)
    file = tmp_path_factory.mktemp("program") / "ensemble.onnx"
    export_onnx(ensemble, file)
    return ensemble, onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])


def difference_from_torch(default_program, height, width):
    ensemble, session = default_program
    rgb = image(height, width)[None]
    with torch.inference_mode():
        expected = torch.sigmoid(ensemble.backend.member_logits(rgb)).numpy()
    assert min(height, width) < 16 or np.ptp(expected) > 0.1
    return np.abs(session.run(["member_p_occupied"], {"rgb": rgb})[0] - expected).max()


@given(height=st.integers(1, 150), width=st.integers(1, 150))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_the_program_agrees_with_torch_at_any_size(default_program, height, width):
    assert difference_from_torch(default_program, height, width) < 1e-5


@pytest.mark.parametrize("size", [(192, 256), (190, 250), (270, 480), (135, 241)])
def test_the_program_agrees_with_torch_at_common_sizes(default_program, size):
    assert difference_from_torch(default_program, *size) < 2e-5


def test_a_program_for_any_size_has_model_version_1(default_program):
    assert default_program[1].get_modelmeta().version == 1


def test_exported_program_fuses_batch_normalization_and_convolves_before_upsampling(frozen):
    graph = onnx.load(frozen / "ensemble.onnx").graph
    kinds = collections.Counter(node.op_type for node in graph.node)
    assert "BatchNormalization" not in kinds
    n_convolutions = sum(isinstance(module, nn.Conv2d) for module in build_network(NETWORK, 0).modules())
    assert kinds["Conv"] == 3 * (n_convolutions + 1 + 2)  # one is split in two; two make the upsampling matrices
    assert kinds["EyeLike"] == 3 * 2
    assert {node.domain for node in graph.node} == {""}


def test_the_programs_decoder_is_rewritten_and_agrees_on_many_images(frozen):
    fast, reference = load_ensemble(frozen, backend=installed("onnxruntime")), load_ensemble(frozen, backend="torch")
    random = np.random.default_rng(5)
    differences, low, high = [], 1.0, 0.0
    for seed in range(24):
        noise = image(*random.integers(20, 200, 2), seed)
        rgb = noise if seed % 2 else np.ascontiguousarray(np.sort(noise, axis=1))
        expected = reference.member_p_occupied(rgb)
        differences.append(np.abs(fast.member_p_occupied(rgb) - expected).max())
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
def test_every_network_can_be_frozen(settings, tmp_path):
    import onnxruntime

    ensemble = Ensemble([network(settings, seed) for seed in range(2)], INFERENCE)
    export_onnx(ensemble, tmp_path / "ensemble.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "ensemble.onnx", providers=["CPUExecutionProvider"])
    for size in ((48, 64), (96, 32), (45, 70), (1, 1)):
        rgb = image(*size)[None]
        with torch.inference_mode():
            expected = torch.sigmoid(ensemble.backend.member_logits(rgb)).numpy()
        assert np.abs(session.run(["member_p_occupied"], {"rgb": rgb})[0] - expected).max() < 1e-4


def test_a_bias_that_is_zero_in_one_member_is_not_lost_in_another(tmp_path):
    import onnxruntime

    networks = [network(NETWORK, seed) for seed in range(2)]
    biases = [name for name, module in networks[0].named_modules() if getattr(module, "bias", None) is not None]
    for first, second in zip(networks[0].named_parameters(), networks[1].named_parameters(), strict=True):
        if first[0] == f"{biases[-1]}.bias":
            first[1].data.zero_()
            second[1].data.fill_(0.8)
    ensemble = Ensemble(networks, INFERENCE)
    export_onnx(ensemble, tmp_path / "ensemble.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "ensemble.onnx", providers=["CPUExecutionProvider"])
    rgb = image(48, 64)[None]
    with torch.inference_mode():
        expected = torch.sigmoid(ensemble.backend.member_logits(rgb)).numpy()
    assert np.abs(session.run(["member_p_occupied"], {"rgb": rgb})[0] - expected).max() < 1e-4


def test_the_program_is_verified_before_any_engine_sees_it(frozen, tmp_path):
    copy = shutil.copytree(frozen, tmp_path / frozen.name)
    data = bytearray((copy / "ensemble.onnx").read_bytes())
    data[len(data) // 2] ^= 1
    (copy / "ensemble.onnx").write_bytes(data)
    for backend in ("auto", "torch", "onnxruntime"):
        with pytest.raises(ArtifactError, match=r"ensemble.onnx: was altered"):
            load_ensemble(copy, backend=backend)


def test_auto_is_the_fastest_at_hand_and_a_missing_one_is_named(monkeypatch):
    cpu, gpu = torch.device("cpu"), torch.device("cuda")
    assert (select_backend("auto", cpu), select_backend("auto", gpu)) == ("onnxruntime", "torch")
    with pytest.raises(SettingsError, match="runs on the CPU"):
        select_backend("onnxruntime", gpu)
    with pytest.raises(SettingsError, match="'tensorrt'"):
        select_backend("tensorrt", cpu)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert select_backend("auto", cpu) == "torch"
    with pytest.raises(SettingsError, match="pip install openvino"):
        select_backend("openvino", cpu)


def test_the_file_is_the_same_each_time(frozen, tmp_path):
    export_onnx(load_ensemble(frozen, backend="torch"), tmp_path / "again.onnx")
    assert pathlib.Path(tmp_path / "again.onnx").read_bytes() == (frozen / "ensemble.onnx").read_bytes()
