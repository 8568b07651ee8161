import dataclasses
import hashlib
import json
import pathlib
import shutil
import subprocess
import sys
import tracemalloc

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

import deltasafe
from deltasafe.cli import main
from deltasafe.errors import ArtifactError, DataError, SettingsError
from deltasafe.io.storage import read_json
from deltasafe.perception.artifact.frozen_ensemble import (
    golden_difference,
    load_ensemble,
    verify_artifact,
    write_frozen_ensemble,
)
from deltasafe.perception.artifact.model_card import model_card
from deltasafe.perception.artifact.promotion import score_ensemble
from deltasafe.perception.calibration.conformal_margin import ConformalMargins
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.calibration.metrics import pool_scores
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network
from tests.ensembles import write_hands

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


def edit_manifest(folder, **changes):
    """Change entries of the manifest; entries of ``files`` are added."""
    manifest = json.loads((folder / "manifest.json").read_text())
    files = {**manifest["files"], **changes.pop("files", {})}
    (folder / "manifest.json").write_text(json.dumps({**manifest, **changes, "files": files}))


def test_ensemble_is_mean_of_members(members):
    ensemble = Ensemble([member.network() for member in members], INFERENCE)
    each = ensemble.member_p_occupied(image(51, 70))
    assert each.shape == (2, 51, 70)
    assert each.dtype == np.float32
    assert np.abs(each.mean(axis=0) - ensemble.p_occupied(image(51, 70))).max() < 1e-6
    assert not np.allclose(each[0], each[1])


@pytest.mark.parametrize("size", [(1, 1), (17, 300), (640, 480)])
def test_predictions_are_probabilities_at_any_image_size(frozen, size):
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
def test_arrays_that_are_not_rgb_images_are_refused(members, wrong):
    with pytest.raises(SettingsError, match="uint8"):
        Ensemble([members[0].network()], INFERENCE).p_occupied(wrong)


def test_network_size_keeps_aspect_ratio_and_area():
    settings = InferenceSettings(256, 192)
    assert settings.network_size(288, 384) == (192, 256)
    height, width = settings.network_size(1000, 500)
    assert height / width == pytest.approx(2, rel=0.1)
    assert height * width == pytest.approx(256 * 192, rel=0.15)


def test_prediction_is_the_mean_over_scales_and_members(members):
    networks, rgb = [member.network() for member in members], image(90, 70, seed=5)
    both = Ensemble(networks, InferenceSettings(64, 48, scales=(1.0, 0.625)))
    each = [Ensemble(networks, InferenceSettings(64, 48, scales=(scale,))) for scale in both.settings.scales]
    expected = np.mean([one.member_p_occupied(rgb) for one in each], axis=0)
    np.testing.assert_allclose(both.member_p_occupied(rgb), expected, atol=1e-6)
    np.testing.assert_allclose(both.p_occupied(rgb), expected.mean(axis=0), atol=1e-6)
    assert np.abs(each[0].p_occupied(rgb) - each[1].p_occupied(rgb)).max() > 1e-4


@pytest.mark.parametrize("scales", [(), (1.0, 1.0), (0.0,), (np.nan,), (5.0,)])
def test_invalid_scales_are_refused(scales):
    with pytest.raises(SettingsError, match="scales"):
        InferenceSettings(scales=scales)


def test_freezing_twice_gives_one_folder(members, frozen):
    again = write_frozen_ensemble(members, INFERENCE, CALIBRATION, image(), frozen.parent)
    assert again == frozen
    assert [path.name for path in frozen.parent.iterdir()] == [frozen.name]


def test_frozen_ensemble_predicts_bit_identically_to_members(members, frozen):
    rgb = image(100, 90, seed=3)
    expected = Ensemble([member.network() for member in members], INFERENCE, temperature=0.6).p_occupied(rgb)
    assert np.array_equal(load_ensemble(frozen, backend="torch").p_occupied(rgb), expected)


def test_temperature_is_applied_to_mean_only(members, frozen):
    rgb = image(30, 50, seed=4)
    plain = Ensemble([member.network() for member in members], INFERENCE)
    each = load_ensemble(frozen, backend="torch").member_p_occupied(rgb)
    assert np.array_equal(each, plain.member_p_occupied(rgb))
    odds = (each.mean(axis=0) / (1 - each.mean(axis=0))) ** (1 / 0.6)
    np.testing.assert_allclose(load_ensemble(frozen).p_occupied(rgb), odds / (1 + odds), atol=1e-6)
    assert np.abs(load_ensemble(frozen).p_occupied(rgb) - plain.p_occupied(rgb)).max() > 1e-3


def test_format_1_loads_with_torch_and_without_temperature(copy, tmp_path):
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
    digest = hashlib.sha256((copy / "calibration.json").read_bytes()).hexdigest()
    edit_manifest(copy, format_version=1, files={"calibration.json": digest})
    pulled = copy.rename(tmp_path / "pulled")
    ensemble = load_ensemble(pulled)
    assert ensemble.backend.name == "torch"
    with pytest.raises(ArtifactError, match="older format"):
        load_ensemble(pulled, backend="onnxruntime")
    assert (ensemble.calibration.smallest_supported_delta, ensemble.calibration.missed_hand_threshold) == (0.03, None)
    assert ensemble.calibration.conformal_margins is None
    mean = ensemble.member_p_occupied(rgb).mean(axis=0, dtype=np.float32)
    assert np.array_equal(ensemble.p_occupied(rgb), mean)


@pytest.mark.parametrize(("version", "backend"), [(2, "torch"), (3, "onnxruntime")])
def test_formats_2_and_3_reproduce_golden_image(members, tmp_path, version, backend):
    """They have one scale, which their manifests do not name."""
    one_scale = dataclasses.replace(INFERENCE, scales=(1.0,))
    older = write_frozen_ensemble(members, one_scale, CALIBRATION, image(), tmp_path)
    manifest = json.loads((older / "manifest.json").read_text())
    assert manifest["format_version"] == 4
    del manifest["network"]["atrous_rates"]  # the first versions stored none
    del manifest["inference"]["scales"]
    edit_manifest(older, format_version=version, network=manifest["network"], inference=manifest["inference"])
    ensemble = load_ensemble(older.rename(tmp_path / "pulled"))
    assert ensemble.settings == one_scale
    assert ensemble.backend.name == backend
    assert golden_difference(ensemble) <= 1e-4


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
    assert manifest["format_version"] == 4
    assert load_ensemble(frozen.rename(tmp_path / "older")).calibration == without
    assert "dilated" not in (tmp_path / "older" / "model_card.md").read_text("utf-8")


def test_damaged_calibration_is_named(tmp_path):
    damaged = dataclasses.asdict(CALIBRATION) | {"conformal_margins": {"deltas": [0.05], "scores": [[0.2, 0.1]]}}
    for text in ('{"surplus": 1}', "[1]", json.dumps(damaged)):
        (tmp_path / "calibration.json").write_text(text)
        with pytest.raises(DataError, match=r"calibration.json: is not a calibration"):
            Calibration.load(tmp_path / "calibration.json")


def test_other_calibration_gives_other_artifact(members, frozen, tmp_path):
    other = write_frozen_ensemble(
        members, INFERENCE, dataclasses.replace(CALIBRATION, temperature=1.5), image(), tmp_path
    )
    assert other.name != frozen.name
    with pytest.raises(SettingsError, match="of 2 members"):
        write_frozen_ensemble(members[:1], INFERENCE, CALIBRATION, image(), tmp_path)


@pytest.mark.parametrize("name", ["member-1.safetensors", "calibration.json", "golden.npz", "ensemble.onnx"])
def test_one_altered_byte_is_found_in_any_file(copy, name):
    data = bytearray((copy / name).read_bytes())
    data[len(data) // 2] ^= 1
    (copy / name).write_bytes(data)
    with pytest.raises(ArtifactError, match="altered") as raised:
        load_ensemble(copy)
    assert raised.value.path.name == name


def test_missing_file_is_named(copy):
    (copy / "member-0.safetensors").unlink()
    with pytest.raises(ArtifactError, match=r"member-0.safetensors: is missing"):
        verify_artifact(copy)


def test_altered_manifest_contradicts_name_of_folder(copy):
    (copy / "calibration.json").write_text("{}")
    edit_manifest(copy, files={"calibration.json": hashlib.sha256(b"{}").hexdigest()})
    with pytest.raises(ArtifactError, match="its manifest belongs to"):
        verify_artifact(copy)


def test_manifest_that_names_file_outside_of_folder_is_refused(copy, tmp_path):
    (tmp_path / "secret").write_text("x")
    edit_manifest(copy, files={"../secret": "0" * 64})
    with pytest.raises(ArtifactError, match="outside of the folder"):
        verify_artifact(copy.rename(tmp_path / "pulled"))


def test_additional_file_and_link_out_of_folder_are_refused(copy, tmp_path):
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


def test_non_finite_weights_are_refused(members, tmp_path):
    network = members[0].network()
    next(network.parameters()).data[0] = float("nan")
    with pytest.raises(ArtifactError, match="non-finite"):
        Member.write(tmp_path, network, members[0].record).network()


def test_unknown_format_and_missing_folder_are_refused(copy, tmp_path):
    (copy / "manifest.json").write_text('{"format_version": 99}')
    with pytest.raises(ArtifactError, match="format_version 99"):
        verify_artifact(copy)
    with pytest.raises(ArtifactError, match="is not a folder"):
        verify_artifact(tmp_path / "none")


def test_golden_image_is_reproduced(frozen):
    assert golden_difference(load_ensemble(frozen)) <= 1e-4


def test_ensemble_with_changed_weights_fails_on_golden_image(frozen):
    ensemble = load_ensemble(frozen, backend="torch")
    for parameter in ensemble.members[0].parameters():
        parameter.data.mul_(1.5)
    with pytest.raises(ArtifactError, match="difference of"):
        golden_difference(ensemble)


def test_artifact_contains_no_path_of_this_machine(frozen):
    for file in frozen.iterdir():
        data = file.read_bytes()
        assert str(pathlib.Path.cwd()).encode() not in data, file.name
        assert b"site-packages" not in data, file.name


def test_ensemble_loads_without_dagster_and_mlflow(frozen):
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


def test_verify_command(frozen, copy, capsys):
    assert main(["verify", str(frozen)]) == 0
    assert "M = 2" in capsys.readouterr().out
    (copy / "model_card.md").write_text("altered")
    assert main(["verify", str(copy)]) == 1
    assert "model_card.md: was altered" in capsys.readouterr().err


def test_predict_command(frozen, tmp_path, capsys):
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


def test_predict_command_never_writes_over_its_inputs(frozen, copy, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("hand.png", "a.16bit.png"):
        cv2.imwrite(name, image(60, 80))
    pathlib.Path("link.png").symlink_to("hand.png")
    pathlib.Path("hard.png").hardlink_to("hand.png")
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    for picture, output in (
        ("hand.png", "hand.png"),
        ("hand.png", "./link.png"),
        ("link.png", "hand.png"),
        ("hand.png", "hard.png"),
        ("a.16bit.png", "a.png"),  # the second file that is written
        ("hand.png", f"{copy.name}/x.png"),
    ):
        assert main(["predict", str(copy), picture, "-o", output]) == 1
        assert "is part of the input" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before
    verify_artifact(copy)


def test_predict_command_takes_a_turned_photograph(frozen, tmp_path, capsys):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(image(60, 80)).save(tmp_path / "phone.jpg", exif=exif)
    assert main(["predict", str(frozen), str(tmp_path / "phone.jpg"), "-o", str(tmp_path / "out.png")]) == 0
    assert cv2.imread(str(tmp_path / "out.png")).shape == (80, 60, 3)


def test_predict_command_scales_a_photograph_of_48_megapixels_down(frozen, tmp_path, capsys, monkeypatch):
    from deltasafe.perception.artifact import frozen_ensemble
    from deltasafe.perception.settings import PREDICTION_PIXELS

    class Recorded:
        def p_occupied(self, rgb):
            self.shape = rgb.shape
            return np.zeros(rgb.shape[:2], np.float32)

    ensemble = Recorded()
    monkeypatch.setattr(frozen_ensemble, "load_ensemble", lambda folder: ensemble)
    Image.new("RGB", (8000, 6000), (120, 90, 60)).save(tmp_path / "phone.jpg")
    tracemalloc.start()
    assert main(["predict", str(frozen), str(tmp_path / "phone.jpg"), "-o", str(tmp_path / "out.png")]) == 0
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    height, width, _ = ensemble.shape
    assert 0.99 * PREDICTION_PIXELS < height * width <= PREDICTION_PIXELS
    assert width / height == pytest.approx(4 / 3, abs=2e-3)
    assert peak < 120 * PREDICTION_PIXELS, "about four arrays of three float64 per pixel"
    assert cv2.imread(str(tmp_path / "out.16bit.png"), cv2.IMREAD_UNCHANGED).shape == (height, width)
    assert f"scaled down from 8000 x 6000 to {width} x {height} pixels" in capsys.readouterr().out


@pytest.mark.parametrize("given", [None, [[[0, 0, 0]]], Image.new("RGB", (64, 48)), torch.zeros(48, 64, 3)])
def test_what_is_no_array_is_refused_as_documented(frozen, given):
    with pytest.raises(SettingsError, match=r"must be a numpy array, uint8 \(H, W, 3\), got .*read_rgb"):
        load_ensemble(frozen).p_occupied(given)
    with pytest.raises(SettingsError, match="numpy array"):
        load_ensemble(frozen).member_p_occupied(given)


def test_devices_are_chosen_or_refused_by_name(members, frozen, monkeypatch):
    networks = [member.network() for member in members]
    expected = "cuda" if torch.cuda.is_available() else "cpu"
    assert Ensemble(networks, INFERENCE, device="auto").device.type == expected
    assert load_ensemble(frozen, device="auto").device.type == expected
    for device in ("gpu", "", "cuda:x", None):
        with pytest.raises(SettingsError, match="device must be auto, cpu, cuda"):
            load_ensemble(frozen, device=device)
    if not torch.cuda.is_available():
        with pytest.raises(SettingsError, match=r"device 'cuda' is not available here .*; use cpu or auto"):
            load_ensemble(frozen, device="cuda")
    with pytest.raises(SettingsError, match="device 'cuda:99' is not available here"):
        Ensemble(networks, INFERENCE, device="cuda:99")


def test_renamed_folder_is_loaded_after_the_remedy_of_the_message(copy):
    """A browser renames a second download."""
    browser = copy.rename(copy.with_name(f"{copy.name} (1)"))
    with pytest.raises(ArtifactError, match="rename it to") as caught:
        verify_artifact(browser)
    verify_artifact(browser.rename(browser.with_name(str(caught.value).split("rename it to ")[1].split()[0])))


def test_files_of_desktops_in_the_folder_are_ignored(copy):
    for name in ("Thumbs.db", "desktop.ini", ".DS_Store", "._manifest.json"):
        (copy / name).touch()
    verify_artifact(copy)
    (copy / "notes.txt").touch()
    with pytest.raises(ArtifactError, match=r"notes\.txt: does not belong"):
        verify_artifact(copy)


def test_model_card_states_supported_delta_or_that_there_is_none():
    manifest = {
        "n_members": 2,
        "seeds": [0, 1],
        "network": dataclasses.asdict(NETWORK),
        "inference": {"width": 64, "height": 48},
        "format_version": 3,
    }
    card = model_card(manifest, CALIBRATION)
    assert "support is **0.03** (at 95% confidence)" in card
    assert "| 0.9700 | 0.9300 | 0.0700 | 0.0200 | 0.0100 |" in card
    none = model_card(manifest, dataclasses.replace(CALIBRATION, smallest_supported_delta=None))
    assert "support **no** delta" in none


def test_evaluate_writes_report_and_metrics(frozen, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_hands(tmp_path / "photographs", 3)
    assert main(["evaluate", str(frozen), "photographs"]) == 0
    assert "3 images: pixel accuracy 0." in capsys.readouterr().out
    figures = read_json(tmp_path / "photographs-evaluation" / "metrics.json")["figures"]
    scores = score_ensemble(frozen, LabeledImageSet.load("photographs"), tmp_path / "scores")
    assert figures["nll"] == pytest.approx(pool_scores(scores).nll, rel=1e-6)
    assert figures["miou"] == pytest.approx(pool_scores(scores).miou, rel=1e-6)
    assert main(["evaluate", str(frozen), "nowhere"]) == 1
    assert "nowhere: is not a folder" in capsys.readouterr().err
