import shutil

import numpy as np
import pytest
import torch

from deltasafe.errors import ArtifactError, SettingsError
from deltasafe.perception.artifact.frozen_ensemble import golden_difference, load_ensemble
from deltasafe.perception.inference.backends import load_program, select_backend
from tests.unit.perception.backend_cases import freeze, image, installed


@pytest.fixture(scope="module")
def frozen(tmp_path_factory):
    return freeze(tmp_path_factory.mktemp("artifacts"))


@pytest.mark.parametrize("backend", ["onnxruntime", "openvino"])
@pytest.mark.parametrize("size", [(48, 64), (1, 1), (17, 300), (300, 40), (240, 320)])
def test_backend_agrees_with_torch_at_any_image_size(frozen, backend, size):
    ensemble, reference = load_ensemble(frozen, backend=installed(backend)), load_ensemble(frozen, backend="torch")
    assert (ensemble.backend.name, reference.backend.name) == (backend, "torch")
    rgb = image(*size, seed=1)
    expected = reference.member_p_occupied(rgb)
    assert np.ptp(expected) > 0 or size == (1, 1)
    assert np.abs(ensemble.member_p_occupied(rgb) - expected).max() < 1e-4
    assert np.abs(ensemble.p_occupied(rgb) - reference.p_occupied(rgb)).max() < 1e-4
    assert golden_difference(ensemble) < 1e-4


@pytest.mark.parametrize("backend", ["auto", "torch", "onnxruntime"])
def test_altered_program_is_refused_with_every_backend(frozen, tmp_path, backend):
    copy = shutil.copytree(frozen, tmp_path / frozen.name)
    data = bytearray((copy / "ensemble.onnx").read_bytes())
    data[len(data) // 2] ^= 1
    (copy / "ensemble.onnx").write_bytes(data)
    with pytest.raises(ArtifactError, match=r"ensemble.onnx: was altered"):
        load_ensemble(copy, backend=backend)


@pytest.mark.parametrize("backend", ["onnxruntime", "openvino"])
def test_file_that_is_no_program_is_refused_by_name(tmp_path, backend):
    (tmp_path / "ensemble.onnx").write_bytes(b"no program")
    with pytest.raises(ArtifactError, match=rf"ensemble.onnx: cannot be loaded by {installed(backend)}"):
        load_program(backend, tmp_path / "ensemble.onnx")


def test_auto_selects_onnxruntime_on_cpu_if_installed(monkeypatch):
    cpu, gpu = torch.device("cpu"), torch.device("cuda")
    assert (select_backend("auto", cpu), select_backend("auto", gpu)) == ("onnxruntime", "torch")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert select_backend("auto", cpu) == "torch"


def test_unusable_backends_are_refused_by_name(monkeypatch):
    with pytest.raises(SettingsError, match="runs on the CPU only"):
        select_backend("onnxruntime", torch.device("cuda"))
    with pytest.raises(SettingsError, match="'tensorrt'"):
        select_backend("tensorrt", torch.device("cpu"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SettingsError, match="pip install openvino"):
        select_backend("openvino", torch.device("cpu"))
