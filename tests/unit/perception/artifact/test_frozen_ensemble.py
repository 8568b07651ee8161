import dataclasses
import hashlib
import json
import pathlib
import shutil
import subprocess
import sys

import numpy as np
import pytest

import deltasafe
from deltasafe.cli import main
from deltasafe.errors import ArtifactError, DataError, SettingsError
from deltasafe.perception.artifact.frozen_ensemble import (
    golden_difference,
    load_ensemble,
    verify_artifact,
    write_frozen_ensemble,
)
from deltasafe.perception.calibration.conformal_margin import ConformalMargins
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network

NETWORK = NetworkSettings(pretrained=False, pyramid_channels=16)
INFERENCE = InferenceSettings(64, 48)
CALIBRATION = Calibration(
    n_images=50,
    n_members=2,
    pixel_accuracy=0.97,
    miou=0.93,
    brier=0.02,
    nll=0.07,
    expected_calibration_error=0.01,
    smallest_supported_delta=0.03,
    temperature=0.6,
    n_calibration_images=40,
    missed_hand_alpha=0.05,
    missed_hand_threshold=0.2,
    conformal_margins=ConformalMargins((0.05, 0.2), ((0.0, 0.0125), (0.02, None))),
)


def image(height=48, width=64, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def members(tmp_path_factory):
    record = {"settings": {"network": dataclasses.asdict(NETWORK)}, "data_digest": "d" * 64}
    return [
        Member.write(tmp_path_factory.mktemp("member"), build_network(NETWORK, seed), {**record, "seed": seed})
        for seed in range(2)
    ]


@pytest.fixture(scope="module")
def frozen(members, tmp_path_factory):
    return write_frozen_ensemble(members, INFERENCE, CALIBRATION, image(), tmp_path_factory.mktemp("artifacts"))


@pytest.fixture
def copy(frozen, tmp_path):
    return shutil.copytree(frozen, tmp_path / frozen.name)


def test_the_mean_of_the_members_is_the_ensemble(members):
    ensemble = Ensemble([member.network() for member in members], INFERENCE)
    each = ensemble.member_p_occupied(image(51, 70))
    assert each.shape == (2, 51, 70)
    assert each.dtype == np.float32
    assert np.abs(each.mean(axis=0) - ensemble.p_occupied(image(51, 70))).max() < 1e-6
    assert not np.allclose(each[0], each[1])


@pytest.mark.parametrize("size", [(1, 1), (17, 300), (640, 480)])
def test_any_size_is_answered_with_probabilities(frozen, size):
    p_occupied = deltasafe.load_ensemble(frozen).p_occupied(image(*size))
    assert p_occupied.shape == size
    assert p_occupied.dtype == np.float32
    assert (p_occupied >= 0).all()
    assert (p_occupied <= 1).all()


@pytest.mark.parametrize(
    "wrong",
    [image().astype(np.float32), image()[..., 0], np.zeros((0, 4, 3), np.uint8)],
    ids=["f32", "2d", "none"],
)
def test_what_is_no_image_is_refused(members, wrong):
    with pytest.raises(SettingsError, match="uint8"):
        Ensemble([members[0].network()], INFERENCE).p_occupied(wrong)


def test_aspect_ratio_is_kept_and_area_is_about_what_was_asked():
    settings = InferenceSettings(256, 192)
    assert settings.network_size(288, 384) == (192, 256)
    height, width = settings.network_size(1000, 500)
    assert height / width == pytest.approx(2, rel=0.1)
    assert height * width == pytest.approx(256 * 192, rel=0.15)


def test_freezing_twice_gives_the_same_name_and_no_second_folder(members, frozen):
    again = write_frozen_ensemble(members, INFERENCE, CALIBRATION, image(), frozen.parent)
    assert again == frozen
    assert [path.name for path in frozen.parent.iterdir()] == [frozen.name]


def test_loaded_and_trained_give_the_same_bits(members, frozen):
    rgb = image(100, 90, seed=3)
    expected = Ensemble([member.network() for member in members], INFERENCE, temperature=0.6).p_occupied(rgb)
    assert np.array_equal(load_ensemble(frozen, backend="torch").p_occupied(rgb), expected)


def test_the_temperature_is_applied_to_the_mean_and_to_no_member(members, frozen):
    rgb = image(30, 50, seed=4)
    plain = Ensemble([member.network() for member in members], INFERENCE)
    each = load_ensemble(frozen, backend="torch").member_p_occupied(rgb)
    assert np.array_equal(each, plain.member_p_occupied(rgb))
    odds = (each.mean(axis=0) / (1 - each.mean(axis=0))) ** (1 / 0.6)
    np.testing.assert_allclose(load_ensemble(frozen).p_occupied(rgb), odds / (1 + odds), atol=1e-6)
    assert np.abs(load_ensemble(frozen).p_occupied(rgb) - plain.p_occupied(rgb)).max() > 1e-3


def test_an_ensemble_of_the_first_format_is_read_as_it_is(copy, tmp_path):
    rgb = image(20, 30)
    old = {
        "n_images": 50,
        "n_members": 2,
        "pixel_accuracy": 0.97,
        "miou": 0.93,
        "brier": 0.02,
        "nll": 0.07,
        "expected_calibration_error": 0.01,
        "smallest_supported_delta": 0.03,
        "level": 0.95,
        "temperature": 1.0,
    }
    (copy / "calibration.json").write_text(json.dumps(old))
    manifest = json.loads((copy / "manifest.json").read_text())
    assert manifest["format_version"] == 3
    manifest["format_version"] = 1
    digest = hashlib.sha256((copy / "calibration.json").read_bytes()).hexdigest()
    manifest["files"]["calibration.json"] = digest
    (copy / "manifest.json").write_text(json.dumps(manifest))
    pulled = copy.rename(tmp_path / "pulled")
    ensemble = load_ensemble(pulled)
    assert ensemble.backend.name == "torch"
    with pytest.raises(ArtifactError, match="older format"):
        load_ensemble(pulled, backend="onnxruntime")
    assert (ensemble.calibration.smallest_supported_delta, ensemble.calibration.missed_hand_threshold) == (0.03, None)
    assert ensemble.calibration.conformal_margins is None
    mean = ensemble.member_p_occupied(rgb).mean(axis=0, dtype=np.float32)
    assert np.array_equal(ensemble.p_occupied(rgb), mean)


def test_margins_are_stored_with_the_ensemble_and_stated_in_the_model_card(frozen):
    calibration = load_ensemble(frozen).calibration
    assert calibration == CALIBRATION
    assert calibration.conformal_margins.margin(0.05, 0.4).fraction_of_width == 0.0125
    assert "dilated by **1.25%** of the image's width" in (frozen / "model_card.md").read_text("utf-8")


def test_an_artifact_without_margins_is_loaded(members, tmp_path):
    without = dataclasses.replace(CALIBRATION, conformal_margins=None)
    frozen = write_frozen_ensemble(members, INFERENCE, without, image(), tmp_path)
    file, manifest = frozen / "calibration.json", json.loads((frozen / "manifest.json").read_text())
    older = json.loads(file.read_text())
    del older["conformal_margins"]
    file.write_text(json.dumps(older))
    manifest["files"][file.name] = hashlib.sha256(file.read_bytes()).hexdigest()
    (frozen / "manifest.json").write_text(json.dumps(manifest))
    assert manifest["format_version"] == 3
    assert load_ensemble(frozen.rename(tmp_path / "older")).calibration == without
    assert "dilated" not in (tmp_path / "older" / "model_card.md").read_text("utf-8")


def test_a_damaged_calibration_is_named(tmp_path):
    damaged = dataclasses.asdict(CALIBRATION) | {"conformal_margins": {"deltas": [0.05], "scores": [[0.2, 0.1]]}}
    for text in ('{"surplus": 1}', "[1]", json.dumps(damaged)):
        (tmp_path / "calibration.json").write_text(text)
        with pytest.raises(DataError, match=r"calibration.json: is not a calibration"):
            Calibration.load(tmp_path / "calibration.json")


def test_another_calibration_is_another_artifact(members, frozen, tmp_path):
    other = write_frozen_ensemble(
        members, INFERENCE, dataclasses.replace(CALIBRATION, temperature=1.5), image(), tmp_path
    )
    assert other.name != frozen.name
    with pytest.raises(SettingsError, match="of 2 members"):
        write_frozen_ensemble(members[:1], INFERENCE, CALIBRATION, image(), tmp_path)


@pytest.mark.parametrize("name", ["member-1.safetensors", "calibration.json", "golden.npz", "ensemble.onnx"])
def test_one_changed_byte_is_found_in_any_file(copy, name):
    data = bytearray((copy / name).read_bytes())
    data[len(data) // 2] ^= 1
    (copy / name).write_bytes(data)
    with pytest.raises(ArtifactError, match="altered") as raised:
        load_ensemble(copy)
    assert raised.value.path.name == name


def test_a_missing_file_is_named(copy):
    (copy / "member-0.safetensors").unlink()
    with pytest.raises(ArtifactError, match=r"member-0.safetensors: is missing"):
        verify_artifact(copy)


def test_a_forged_manifest_contradicts_the_name_of_the_folder(copy):
    manifest = json.loads((copy / "manifest.json").read_text())
    (copy / "calibration.json").write_text("{}")
    manifest["files"]["calibration.json"] = hashlib.sha256(b"{}").hexdigest()
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ArtifactError, match="its manifest belongs to"):
        verify_artifact(copy)


def test_a_manifest_may_not_point_outside_of_its_folder(copy, tmp_path):
    (tmp_path / "secret").write_text("x")
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["files"]["../secret"] = "0" * 64
    (copy / "manifest.json").write_text(json.dumps(manifest))
    renamed = copy.rename(tmp_path / "pulled")
    with pytest.raises(ArtifactError, match="outside of the folder"):
        verify_artifact(renamed)


def test_a_file_more_and_a_link_out_of_the_folder_are_refused(copy, tmp_path):
    (copy / "run.py").write_text("print()")
    with pytest.raises(ArtifactError, match=r"run\.py: does not belong"):
        verify_artifact(copy)
    (copy / "run.py").unlink()
    (copy / ".DS_Store").write_text("left by a desktop")
    verify_artifact(copy)
    outside = (copy / "golden.npz").rename(tmp_path / "golden.npz")
    (copy / "golden.npz").symlink_to(outside)
    with pytest.raises(ArtifactError, match=r"golden\.npz: is a link out of the folder"):
        verify_artifact(copy)


def test_weights_that_are_not_finite_are_refused(members, tmp_path):
    network = members[0].network()
    next(network.parameters()).data[0] = float("nan")
    with pytest.raises(ArtifactError, match="not finite"):
        Member.write(tmp_path, network, members[0].record).network()


def test_an_unknown_format_and_a_missing_folder_are_refused(copy, tmp_path):
    (copy / "manifest.json").write_text('{"format_version": 99}')
    with pytest.raises(ArtifactError, match="format_version 99"):
        verify_artifact(copy)
    with pytest.raises(ArtifactError, match="is not a folder"):
        verify_artifact(tmp_path / "none")


def test_the_golden_image_is_answered_as_stored(frozen):
    assert golden_difference(load_ensemble(frozen)) <= 1e-4


def test_an_ensemble_that_answers_otherwise_fails_on_its_golden_image(frozen):
    ensemble = load_ensemble(frozen, backend="torch")
    for parameter in ensemble.members[0].parameters():
        parameter.data.mul_(1.5)
    with pytest.raises(ArtifactError, match="difference of"):
        golden_difference(ensemble)


def test_nothing_in_the_artifact_names_this_machine(frozen):
    for file in frozen.iterdir():
        data = file.read_bytes()
        assert str(pathlib.Path.cwd()).encode() not in data, file.name
        assert b"site-packages" not in data, file.name


def test_it_loads_where_neither_dagster_nor_mlflow_can_be_imported(frozen):
    program = f"""
import sys
class Refused:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("dagster", "mlflow", "pybullet", "albumentations"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Refused())
import numpy as np, deltasafe
p = deltasafe.load_ensemble({str(frozen)!r}).p_occupied(np.zeros((30, 40, 3), np.uint8))
assert p.shape == (30, 40), p.shape
"""
    subprocess.run([sys.executable, "-c", program], check=True)


def test_verify_on_the_command_line(frozen, copy, capsys):
    assert main(["verify", str(frozen)]) == 0
    assert "M = 2" in capsys.readouterr().out
    (copy / "model_card.md").write_text("better than it is")
    assert main(["verify", str(copy)]) == 1
    assert "model_card.md: was altered" in capsys.readouterr().err


def test_predict_on_the_command_line(frozen, tmp_path, capsys):
    import cv2

    picture = tmp_path / "hand.png"
    cv2.imwrite(str(picture), image(60, 80))
    output = tmp_path / "out.png"
    assert main(["predict", str(frozen), str(picture), "-o", str(output)]) == 0
    assert cv2.imread(str(output)).shape == (60, 80, 3)
    stored = cv2.imread(str(tmp_path / "out.16bit.png"), cv2.IMREAD_UNCHANGED)
    rgb = cv2.cvtColor(cv2.imread(str(picture)), cv2.COLOR_BGR2RGB)
    assert np.abs(stored / 65535 - load_ensemble(frozen).p_occupied(rgb)).max() <= 1e-5
    assert main(["predict", str(frozen), str(tmp_path / "none.png")]) == 1
    assert "none.png" in capsys.readouterr().err
