"""The example scripts, loaded by path as another project would copy them."""

import ast
import dataclasses
import importlib.util
import pathlib
import shutil
import subprocess
import sys
import tomllib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import deltasafe
from deltasafe import ArtifactError, PlannedMotion, load_ensemble, perception
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.images import read_rgb
from deltasafe.perception.artifact.frozen_ensemble import write_frozen_ensemble
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network
from tests.ensembles import CALIBRATION, freeze_constant

ROOT = pathlib.Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SCENE = ROOT / "datasets" / "scenes" / "scene_000"
HANDS = ROOT / "datasets" / "hands"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NAME = "deltasafe-hand-ensemble"


def script(name):
    spec = importlib.util.spec_from_file_location(f"examples_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def image(height, width, seed=0):
    noise = np.random.default_rng(seed).integers(0, 256, (9, 12, 3), dtype=np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)


@pytest.fixture(scope="module")
def numpy_alone():
    return script("with_onnxruntime")


@pytest.fixture(scope="module")
def frozen(tmp_path_factory):
    """Two random networks, and a temperature."""
    settings = NetworkSettings(pretrained=False, pyramid_channels=16)
    record = {"settings": {"network": dataclasses.asdict(settings)}, "data_digest": "d" * 64}
    home = tmp_path_factory.mktemp("home")
    members = [
        Member.write(home / f"member{seed}", build_network(settings, seed), {**record, "seed": seed})
        for seed in range(2)
    ]
    calibration = dataclasses.replace(CALIBRATION, n_members=2, temperature=0.6)
    return write_frozen_ensemble(members, InferenceSettings(64, 48), calibration, image(72, 96), home / "frozen")


@pytest.fixture(scope="module")
def sees_nothing(tmp_path_factory):
    return freeze_constant(tmp_path_factory.mktemp("home"), -6.0)


@pytest.fixture
def copy(frozen, tmp_path):
    return shutil.copytree(frozen, tmp_path / frozen.name)


@pytest.fixture
def call(monkeypatch, tmp_path):
    """Run the main function of a script in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(name, *arguments):
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *map(str, arguments)])
        script(name).main()

    return run


# 64 x 48 is not scaled; for 96 x 72 and 160 x 120 no mean is a half, whose rounding may differ
@pytest.mark.parametrize("size", [(48, 64), (72, 96), (120, 160)])
def test_onnxruntime_agrees_with_torch(numpy_alone, frozen, size):
    rgb = image(*size, seed=1)
    expected = load_ensemble(frozen, backend="torch").p_occupied(rgb)
    found = numpy_alone.HandEnsemble(frozen).p_occupied(rgb)
    assert (found.shape, found.dtype) == (size, np.float32)
    assert np.ptp(expected) > 0.01, "the comparison needs a prediction that is not constant"
    assert np.abs(found - expected).max() < 1e-4


@given(st.integers(2, 300), st.integers(2, 300))
def test_scaling_weights_are_means(size, target):
    module = script("with_onnxruntime")
    for weights in (module.area(size, target), module.bilinear(size, target)):
        assert weights.shape == (target, size)
        assert weights.min() >= 0
        np.testing.assert_allclose(weights.sum(axis=1), 1)
    np.testing.assert_allclose(module.area(size, target).sum(axis=0), target / size)


@pytest.mark.parametrize(("size", "target"), [((97, 131), (48, 64)), ((30, 44), (48, 80))])
def test_scaling_agrees_with_opencv(numpy_alone, size, target):
    rgb = image(*size, seed=2)
    weights, method = (numpy_alone.area, cv2.INTER_AREA) if target < size else (numpy_alone.bilinear, cv2.INTER_LINEAR)
    rows, columns = (weights(old, new) for old, new in zip(size, target, strict=True))
    found = np.einsum("yY,YXc,xX->yxc", rows, rgb.astype(float), columns)
    expected = cv2.resize(rgb.astype(np.float32), target[::-1], interpolation=method)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_onnxruntime_example_verifies_every_file(numpy_alone, frozen, copy):
    names = sorted(path.name for path in frozen.iterdir())
    assert len(names) == 7
    for name in names:
        file = copy / name
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
        with pytest.raises(numpy_alone.ArtifactError, match=f"{name}: was altered"):
            numpy_alone.HandEnsemble(copy)
        file.unlink()
        with pytest.raises(numpy_alone.ArtifactError, match=f"{name}.* is missing"):
            numpy_alone.HandEnsemble(copy)
        shutil.copyfile(frozen / name, file)
    numpy_alone.HandEnsemble(copy)
    with pytest.raises(numpy_alone.ArtifactError, match="renamed"):
        numpy_alone.HandEnsemble(copy.rename(copy.with_name("ensemble-0123456789abcdef")))


def test_renamed_folder_is_loaded_after_the_remedy_of_the_message(numpy_alone, copy):
    """A browser renames a second download."""
    browser = copy.rename(copy.with_name(f"{copy.name} (1)"))
    with pytest.raises(numpy_alone.ArtifactError) as caught:
        numpy_alone.HandEnsemble(browser)
    numpy_alone.HandEnsemble(browser.rename(browser.with_name(str(caught.value).split("rename it to ")[1].split()[0])))


@pytest.mark.parametrize("orientation", [1, 3, 6])
@pytest.mark.parametrize("mode", ["RGB", "L", "P", "RGBA"])
def test_onnxruntime_example_reads_images_as_the_library_does(numpy_alone, tmp_path, mode, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(image(12, 20, seed=4)).convert(mode).save(tmp_path / "x.png", exif=exif)
    np.testing.assert_array_equal(numpy_alone.read_rgb(tmp_path / "x.png"), read_rgb(tmp_path / "x.png"))


@pytest.mark.parametrize("kind", ["16 bits", "32 bits", "floats", "transparent"])
def test_onnxruntime_example_refuses_what_it_would_read_wrong(numpy_alone, tmp_path, kind):
    gray = image(12, 20, seed=4)[..., 0]
    pixels = {"16 bits": gray.astype(np.uint16) * 257, "32 bits": gray.astype(np.int32), "floats": gray / np.float32(9)}
    picture = Image.fromarray(pixels.get(kind, gray))
    if kind == "transparent":
        picture.putalpha(Image.fromarray(gray))
    picture.save(tmp_path / "x.tif")
    with pytest.raises(numpy_alone.ArtifactError, match=r"x\.tif: .*; (convert|save)"):
        numpy_alone.read_rgb(tmp_path / "x.tif")


def test_another_prediction_of_the_golden_image_is_refused(numpy_alone, frozen, monkeypatch):
    monkeypatch.setattr(numpy_alone, "bilinear", numpy_alone.area)
    with pytest.raises(numpy_alone.ArtifactError, match="golden"):
        numpy_alone.HandEnsemble(frozen)


@pytest.mark.parametrize("name", ["from_folder", "with_onnxruntime"])
def test_folder_examples_write_the_probability(call, frozen, name, tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "image.png"), image(72, 96, seed=3)[..., ::-1])
    call(name, frozen, "image.png", "-o", "found.npy")
    found = np.load(tmp_path / "found.npy", allow_pickle=False)
    assert np.abs(found - load_ensemble(frozen).p_occupied(image(72, 96, seed=3))).max() < 1e-4
    assert f"{frozen.name}: intact" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "there"), [("from_folder", True), ("with_onnxruntime", True), ("with_onnxruntime", False)]
)
def test_an_altered_or_missing_folder_is_reported_in_one_line(copy, tmp_path, name, there):
    (copy / "ensemble.onnx").write_bytes(b"another program")
    folder, said = (copy, "ensemble.onnx: was altered") if there else (tmp_path / "nowhere", "nowhere: is not")
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), str(folder), str(SCENE / "image.jpg")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={"PYTHONPATH": str(ROOT)})
    assert done.returncode == 1
    assert said in done.stderr
    assert done.stderr.startswith(f"{name}: ")
    assert done.stderr.count("\n") == 1


def test_a_motion_around_a_hand_is_planned_and_drawn(call, sees_nothing, tmp_path, capsys):
    call("plan_around_a_hand", sees_nothing, SCENE, "-o", tmp_path / "plan")
    motion = PlannedMotion.load(tmp_path / "plan")
    assert motion.is_safe
    assert motion.settings.delta == 0.05
    assert cv2.imread(str(tmp_path / "plan" / "plan.png")) is not None
    assert f"{motion.trajectory.duration_s:.1f} s" in capsys.readouterr().out


def test_the_reason_for_no_motion_is_reported(call, frozen, tmp_path):
    """Random networks predict a hand everywhere."""
    with pytest.raises(SystemExit, match=r"no motion is safe at delta = 0\.05: .*start"):
        call("plan_around_a_hand", frozen, SCENE, "-o", tmp_path / "plan")


def test_a_delta_below_the_supported_one_is_refused(call, sees_nothing, tmp_path):
    with pytest.raises(SettingsError, match=r"0\.02 is refused: .*is 0\.05"):
        call("plan_around_a_hand", sees_nothing, SCENE, "-o", tmp_path / "plan", "--delta", "0.02")
    assert not (tmp_path / "plan").exists()


def test_a_motion_among_obstacles_is_planned_and_audited(tmp_path):
    command = [sys.executable, str(EXAMPLES / "plan_a_motion.py"), str(tmp_path / "motion")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env={"PYTHONPATH": str(ROOT)})
    assert PlannedMotion.load(tmp_path / "motion").is_safe
    assert "\n0 of " in done.stdout


def hands(source, folder, n):
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True)
        for file in sorted((source / kind).iterdir())[:n]:
            shutil.copyfile(file, folder / kind / file.name)
    return str(folder)


def test_an_ensemble_is_trained_and_frozen(tmp_path):
    train, test = hands(HANDS / "train", tmp_path / "train", 8), hands(HANDS / "test", tmp_path / "test", 6)
    frozen = script("train_an_ensemble").main(train, test, str(tmp_path / "out"), quick=True)
    ensemble = load_ensemble(frozen)
    assert len(ensemble) == 2
    assert perception.golden_difference(ensemble) < 1e-4
    assert (tmp_path / "out" / "report" / "report.md").is_file()
    with pytest.raises(DataError):
        script("train_an_ensemble").main(train, train, str(tmp_path / "other"), quick=True)
    assert not (tmp_path / "other").exists()


@pytest.fixture
def registry(frozen, tmp_path, monkeypatch):
    """An MLflow registry with ``frozen`` as champion, and the stored copy of the folder."""
    from mlflow import MlflowClient, set_tracking_uri

    monkeypatch.setenv("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    address = f"sqlite:///{tmp_path / 'mlflow.db'}"
    model = tmp_path / "model"
    stored = shutil.copytree(frozen, model / "artifacts" / frozen.name)
    client = MlflowClient(address)
    client.create_registered_model(NAME)
    client.create_model_version(NAME, model.as_uri(), tags={"artifact": frozen.name})
    client.create_model_version(NAME, model.as_uri(), tags={"artifact": "ensemble-0123456789abcdef"})
    client.create_model_version(NAME, model.as_uri())
    for alias, version in (("champion", "1"), ("elsewhere", "2"), ("foreign", "3")):
        client.set_registered_model_alias(NAME, alias, version)
    yield address, stored
    set_tracking_uri(None)


@pytest.mark.filterwarnings("ignore")  # from MLflow
def test_the_champion_is_loaded_from_the_registry(call, frozen, registry, tmp_path, capsys):
    from mlflow.exceptions import MlflowException

    address, stored = registry
    cv2.imwrite(str(tmp_path / "image.png"), image(72, 96, seed=4)[..., ::-1])
    call("from_registry", "image.png", "--registry", address)
    found = np.load(tmp_path / "p_occupied.npy", allow_pickle=False)
    assert np.abs(found - load_ensemble(frozen).p_occupied(image(72, 96, seed=4))).max() < 1e-4
    assert f"champion is {frozen.name}: intact" in capsys.readouterr().out

    for alias, error, said in (
        ("missing", MlflowException, "missing"),
        ("foreign", ArtifactError, "not registered by deltasafe"),
        ("elsewhere", (MlflowException, OSError), "ensemble-0123456789abcdef"),
    ):
        with pytest.raises(error, match=said):
            call("from_registry", "image.png", "--registry", address, "--alias", alias)
    (stored / "member-1.safetensors").write_bytes(b"other weights")
    with pytest.raises(ArtifactError, match=r"member-1\.safetensors: was altered"):
        call("from_registry", "image.png", "--registry", address)


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_an_example_imports_its_dependencies_and_the_public_api_only(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module.split(".")[0])
            if node.module.startswith("deltasafe"):
                assert node.module == "deltasafe"
                assert {name.name for name in node.names} <= {*deltasafe.__all__, "perception"}
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "perception":
            assert node.attr in perception.__all__
    installed = {"with_onnxruntime": {"numpy", "onnxruntime", "PIL"}, "from_registry": {"numpy", "mlflow", "deltasafe"}}
    assert imported - sys.stdlib_module_names <= installed.get(path.stem, {"numpy", "deltasafe"})
    assert f"python {path.name} " in ast.get_docstring(tree)


def test_the_dependencies_of_the_examples_name_the_extra_of_the_library():
    own = tomllib.loads((EXAMPLES / "pyproject.toml").read_text())["dependency-groups"]
    library = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert own["torch"] == [f"{library['name']}[vision]"]
    assert "vision" in library["optional-dependencies"]
    assert not any(name.startswith(("deltasafe", "torch", "dagster", "mlflow")) for name in own["onnx"])
