"""The studies: the cells, equal numbers of steps, and reuse of finished work."""

import dataclasses
import pathlib
import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.report import CalibrationSettings
from deltasafe.perception.data.augmentation import AugmentationSettings
from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.schemes import SCHEMES, CutoutSettings, MixupSettings
from deltasafe.perception.inference.predictions import MemberPredictions
from deltasafe.perception.settings import InferenceSettings, NetworkSettings, TrainingSettings
from deltasafe.perception.training.train_member import train_member, training_identity
from deltasafe.presets import PRESETS
from deltasafe.studies.perception import Cell, StudySettings
from deltasafe.studies.perception import study as module
from deltasafe.studies.perception.study import Study

DATASETS = pathlib.Path(__file__).parents[4] / "datasets"
SMALL = StudySettings(sizes=(6, 12), n_members=2, n_members_most=3, n_members_ablation=1, left_out=("flip",))


def first_hands(kind: str, n: int, folder: pathlib.Path) -> LabeledImageSet:
    for part in ("images", "masks"):
        (folder / part).mkdir(parents=True)
        for source in sorted((DATASETS / "hands" / kind / part).iterdir())[:n]:
            shutil.copy(source, folder / part)
    return LabeledImageSet.load(folder)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    root = tmp_path_factory.mktemp("study")
    return Study(
        settings=SMALL,
        augmentation=AugmentationSettings(width=64, height=48),
        training=TrainingSettings(NetworkSettings(pyramid_channels=16), epochs=1, batch_size=2),
        inference=InferenceSettings(64, 48),
        calibration=CalibrationSettings(n_bootstrap=100),
        train=first_hands("train", 3, root / "train"),
        test=first_hands("test", 2, root / "test"),
        backgrounds=None,
        home=root / "home",
        device="cpu",
        workers=1,
    )


@pytest.fixture
def trained(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the trained members; trains in this process, which is faster for six steps."""
    names: list[str] = []

    def train_here(jobs, data, settings, *, device, workers, on_step, executor):
        for job in jobs:
            names.append(job.name)
            train_member(AugmentedSet.load(data), settings, job.seed, job.folder, device)

    monkeypatch.setattr(module, "train_members", train_here)
    return names


def test_cells_are_those_of_the_paper_and_ours_comes_first() -> None:
    cells = StudySettings().cells()
    assert len(cells) == 10 + 8
    assert len({cell.name for cell in cells}) == 18
    assert [cell.name for cell in cells[:3]] == ["ours-1000", "ours-200", "cutout-1000"]
    assert {(cell.scheme, cell.n_images) for cell in cells[:10]} == {(s, n) for s in SCHEMES for n in (200, 1000)}
    assert [cell.n_members for cell in cells] == [10] + 9 * [5] + 8 * [2]
    assert cells[10].name == "ours-1000-without-background"
    assert [cell.scheme for cell in StudySettings().schemes()] == 2 * list(SCHEMES)


@pytest.mark.parametrize("preset", PRESETS)
def test_every_cell_of_a_preset_takes_the_same_number_of_steps(preset: str, study: Study) -> None:
    chosen = PRESETS[preset]
    whole = dataclasses.replace(study, settings=chosen.study, training=chosen.training)
    for cell in chosen.study.cells():
        training = whole.training_settings(cell)
        assert training.epochs * (cell.n_images // training.batch_size) == whole.n_steps(cell)
    assert whole.training_settings(chosen.study.largest) == chosen.training


def test_lighter_recipe_applies_to_comparisons_but_not_to_table_3(study: Study) -> None:
    settings = StudySettings(sizes=(300, 1500), comparison_width=96, comparison_epochs=1)
    cells = settings.cells()
    assert cells[0].name == settings.largest.name == "ours-1500-full"
    assert len({cell.name for cell in cells}) == 1 + 10 + 8
    assert {cell.n_members for cell in settings.schemes()} == {5}
    lighter = dataclasses.replace(study, settings=settings, augmentation=AugmentationSettings(width=128, height=96))
    lighter = dataclasses.replace(lighter, training=TrainingSettings(epochs=4))
    steps = {cell.name: lighter.n_steps(cell) for cell in cells}
    assert steps.pop("ours-1500-full") == 4 * set(steps.values()).pop()
    assert len(set(steps.values())) == 1
    sizes = {cell: lighter.scheme_settings(cell) for cell in cells if not cell.left_out}
    assert (sizes[settings.largest].width, sizes[settings.largest].height) == (128, 96)
    assert {(made.width, made.height) for cell, made in sizes.items() if not cell.full} == {(96, 72)}
    larger = dataclasses.replace(lighter, inference=InferenceSettings(160, 120))
    assert larger.inference_settings(settings.largest) == InferenceSettings(160, 120)
    assert {larger.inference_settings(cell) for cell in cells if not cell.full} == {InferenceSettings(120, 90)}


@given(st.integers(1, 9), st.integers(2, 16), st.integers(1, 30), st.integers(1, 12), st.booleans())
def test_smaller_sets_get_more_epochs_or_are_refused(
    study: Study, epochs: int, batch: int, small: int, factor: int, exponential: bool
) -> None:
    sizes = (3 * small, 3 * small * (factor + 1))
    schedule = "exponential" if exponential else "one_cycle"
    training = TrainingSettings(epochs=epochs, batch_size=batch, schedule=schedule)
    other = dataclasses.replace(study, settings=dataclasses.replace(SMALL, sizes=sizes), training=training)
    try:
        made = other.training_settings(Cell("cutout", sizes[0], 1))
    except SettingsError:
        assert other.n_steps(other.settings.largest) % max(1, sizes[0] // batch)
        return
    assert made.epochs * max(1, sizes[0] // batch) == other.n_steps(other.settings.largest)
    assert made.epoch_decay**made.epochs == pytest.approx(
        training.epoch_decay ** (epochs if exponential else made.epochs)
    )


def test_every_scheme_makes_the_number_of_images_of_its_cell(study: Study) -> None:
    for cell in study.settings.cells():
        made = study.scheme_settings(cell)
        assert made.n_variants * len(study.train) == cell.n_images
        assert (made.width, made.height, made.seed) == (64, 48, 0)
    chosen = dataclasses.replace(study, settings=dataclasses.replace(SMALL, cutout_side=0.25, mixup_alpha=1.0))
    assert chosen.scheme_settings(Cell("cutout", 6, 1)) == CutoutSettings(2, 64, 48, side=0.25)
    assert chosen.scheme_settings(Cell("mixup", 6, 1)) == MixupSettings(2, 64, 48, alpha=1.0)
    assert chosen.scheme_settings(Cell("ours", 12, 1, "flip")).left_out == ("flip",)
    with pytest.raises(SettingsError, match="no multiple of the 3 originals"):
        study.scheme_settings(Cell("cutout", 7, 1))


def test_cell_is_computed_once_and_a_larger_ensemble_reuses_its_members(
    study: Study, trained: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = Cell("mixup", 6, 2)
    assert study.find(cell) is None
    assert study.steps_left(cell) == 2 * 6
    report = study.evaluate(cell)
    assert trained == ["mixup-6/0", "mixup-6/1"]
    assert {len(member.losses) for member in study.find_members(cell)} == {6}
    assert (report.n_members, len(report.image_ids), study.steps_left(cell)) == (2, 2, 0)
    assert study.evaluate(cell) == study.find(cell)
    assert trained == ["mixup-6/0", "mixup-6/1"]

    predicted: list[int] = []
    write = MemberPredictions.write

    def counted(folder, image_ids, predict, progress):
        predicted.append(len(image_ids))
        return write(folder, image_ids, predict, progress)

    monkeypatch.setattr(MemberPredictions, "write", counted)
    larger = study.evaluate(Cell("mixup", 6, 3))
    assert trained[2:] == ["mixup-6/2"]
    assert predicted == [2], "only the new member predicts the two test images"
    assert larger.ensembles[1].scores == report.ensembles[1].scores
    assert larger.members[:2] == report.members


def test_stacked_predictions_equal_those_of_the_ensemble(study: Study, trained: list[str]) -> None:
    cell = Cell("mixup", 6, 2)
    study.evaluate(cell)
    members = study.members(cell)
    stacked = study.predictions(cell, members)
    ensemble = module.Ensemble([member.network() for member in members], study.inference)
    assert len(stacked) == 2
    for index in range(2):
        image, mask = study.test.read(index)
        assert stacked[index].shape == (2, *mask.shape)
        np.testing.assert_allclose(stacked[index], ensemble.member_p_occupied(image), atol=1e-6)


def test_members_of_the_chain_are_reused(study: Study, trained: list[str], tmp_path: pathlib.Path) -> None:
    """The chain has its own copy of the augmented set, and stores members by identity."""
    ours = dataclasses.replace(study.augmentation, n_variants=4)
    data = augment_images(study.train, tmp_path / "chain", ours, workers=1)
    identity = training_identity(data, study.training, seed=0)
    train_member(data, study.training, 0, study.home / "ensemble_member" / identity[:16], device="cpu")
    study.evaluate(Cell("ours", 12, 2))
    assert trained == ["ours-12/1"]


def test_finished_cells_are_listed_without_computing(
    study: Study, trained: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    study.evaluate(Cell("mixup", 6, 2))

    def refuse(*arguments, **named):
        raise AssertionError("nothing is to be computed")

    for name in ("train_members", "evaluate"):
        monkeypatch.setattr(module, name, refuse)
    monkeypatch.setattr(MemberPredictions, "write", refuse)
    assert set(study.finished()) == {"mixup-6"}
    other = dataclasses.replace(study, inference=InferenceSettings(96, 64))
    assert other.finished() == {}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"sizes": (1000, 200)}, "ascending"),
        ({"sizes": ()}, "sizes must be whole numbers in"),
        ({"n_members": 11}, r"n_members must be in \[1, 10\], got 11"),
        ({"n_members_ablation": 6}, r"n_members_ablation must be in \[1, 5\], got 6"),
        ({"left_out": ("shadow",)}, "left_out is 'shadow'"),
        ({"first_seed": -1}, "first_seed"),
    ],
)
def test_settings_outside_their_domain_are_refused(value: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        StudySettings(**value)


def test_cells_of_unknown_schemes_and_methods_are_refused() -> None:
    with pytest.raises(SettingsError, match="choose one of cutout"):
        Cell("cutmix", 200, 5)
    with pytest.raises(SettingsError, match="only our scheme has methods"):
        Cell("mixup", 200, 5, "flip")
    with pytest.raises(SettingsError, match="n_members must be at least 1"):
        Cell("mixup", 200, 0)
