import dataclasses
import math
import os
import pathlib
import shutil

import numpy as np
import pytest
import torch

from deltasafe.errors import ArtifactError, DataError, LockedError, SettingsError
from deltasafe.io.locks import FileLock
from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.data.loader import Batches
from deltasafe.perception.settings import NetworkSettings, TrainingSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network
from deltasafe.perception.training.precision import convert_to_low_precision
from deltasafe.perception.training.train_member import learning_rate, train_member

SMALL = TrainingSettings(
    NetworkSettings(pretrained=False, pyramid_channels=16), epochs=2, batch_size=4, checkpoint_every_steps=3
)


class Stopped(Exception):
    pass


def stop_at(step):
    def on_step(report):
        if report.step == step:
            raise Stopped

    return on_step


def fail_on_step(report):
    raise AssertionError("trained again")


@pytest.fixture(scope="module")
def data():
    """Bright squares on a dark background, which a network learns within a few steps."""
    rng = np.random.default_rng(0)
    masks = np.zeros((16, 48, 64), np.uint8)
    for mask in masks:
        row, column = rng.integers(0, 24), rng.integers(0, 32)
        mask[row : row + 24, column : column + 32] = 1
    images = (masks[..., None] * 180 + rng.integers(0, 60, (16, 48, 64, 3))).astype(np.uint8)
    return InMemorySet(images, masks)


@dataclasses.dataclass(frozen=True)
class InMemorySet:
    images: np.ndarray
    masks: np.ndarray
    digest: str = "0" * 64

    def labels(self, batch):
        return self.masks[batch].astype(np.float32)


def weights(member):
    from safetensors.torch import load_file

    return load_file(member.weights)


def test_in_memory_set_has_attributes_of_augmented_set():
    assert {"images", "masks", "digest", "labels"} <= {field.name for field in dataclasses.fields(AugmentedSet)} | set(
        vars(AugmentedSet)
    )


@pytest.fixture(scope="module")
def uninterrupted(data, tmp_path_factory):
    return train_member(data, SMALL, 7, tmp_path_factory.mktemp("whole"), "cpu")


def test_resume_gives_identical_weights(data, uninterrupted, tmp_path):
    for step in (2, 5):  # before the first checkpoint, and between two of them
        with pytest.raises(Stopped):
            train_member(data, SMALL, 7, tmp_path, "cpu", stop_at(step))
    resumed = []
    member = train_member(data, SMALL, 7, tmp_path, "cpu", lambda report: resumed.append(report.step))
    assert resumed == [4, 5, 6, 7, 8]
    assert member.losses == uninterrupted.losses
    expected = weights(uninterrupted)
    assert all(torch.equal(value, expected[key]) for key, value in weights(member).items())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["member.json", "weights.safetensors"]


def test_second_training_in_same_folder_is_refused(data, tmp_path, monkeypatch):
    monkeypatch.setattr("deltasafe.perception.training.train_member._LOCK_TIMEOUT_S", 0.0)
    with FileLock(tmp_path / "training.lock"):
        with pytest.raises(LockedError, match=f"is in use by process {os.getpid()} of "):
            train_member(data, SMALL, 7, tmp_path, "cpu")
        assert [path.name for path in tmp_path.iterdir()] == ["training.lock"]


def test_training_that_waited_for_lock_reuses_member(data, uninterrupted, tmp_path, monkeypatch):
    def finish_meanwhile(lock):
        shutil.copytree(uninterrupted.folder, tmp_path, dirs_exist_ok=True)
        return lock

    monkeypatch.setattr(FileLock, "__enter__", finish_meanwhile)
    monkeypatch.setattr(FileLock, "__exit__", lambda *_: None)

    assert train_member(data, SMALL, 7, tmp_path, "cpu", fail_on_step).record == uninterrupted.record


def test_finished_member_is_not_trained_again(data, uninterrupted):
    again = train_member(data, SMALL, 7, uninterrupted.folder, "cpu", fail_on_step)
    assert again.record == uninterrupted.record


def test_checkpoint_of_other_settings_is_ignored(data, tmp_path):
    with pytest.raises(Stopped):
        train_member(data, SMALL, 7, tmp_path, "cpu", stop_at(4))
    steps = []
    train_member(data, dataclasses.replace(SMALL, epochs=1), 7, tmp_path, "cpu", lambda r: steps.append(r.step))
    assert steps[0] == 1


def test_seed_changes_losses_and_identity_but_not_ensemble_identity(data, uninterrupted, tmp_path):
    other = train_member(data, SMALL, 8, tmp_path, "cpu")
    assert other.losses != uninterrupted.losses
    assert other.ensemble_identity == uninterrupted.ensemble_identity
    assert other.record["identity"] != uninterrupted.record["identity"]


def test_loss_starts_near_log_2_and_falls(data, tmp_path):
    longer = dataclasses.replace(SMALL, epochs=6)
    losses = train_member(data, longer, 0, tmp_path, "cpu").losses
    assert losses[0] == pytest.approx(math.log(2), abs=0.4)
    assert losses[-1] < 0.5 * losses[0]


def test_altered_or_incomplete_member_is_refused(data, tmp_path):
    member = train_member(data, dataclasses.replace(SMALL, epochs=1), 0, tmp_path, "cpu")
    with member.weights.open("r+b") as file:
        file.seek(-1, 2)
        file.write(b"\x7f")
    with pytest.raises(ArtifactError, match="differs"):
        Member.load(tmp_path)
    member.weights.unlink()
    with pytest.raises(DataError, match="train the member again"):
        Member.load(tmp_path)


def test_set_smaller_than_a_batch_is_refused_before_writing(data, tmp_path):
    with pytest.raises(SettingsError, match="batch_size 32"):
        train_member(data, dataclasses.replace(SMALL, batch_size=32), 0, tmp_path / "new", "cpu")
    assert not (tmp_path / "new").exists()


def test_one_cycle_rises_to_peak_and_falls_to_zero():
    settings = TrainingSettings(epochs=4, peak_learning_rate=1e-3)
    rates = [learning_rate(settings, step, 50) for step in range(200)]
    assert np.argmax(rates) == 49
    assert max(rates) == pytest.approx(1e-3)
    assert 0 < rates[-1] < 1e-6
    assert (np.diff(rates[:50]) > 0).all()
    assert (np.diff(rates[50:]) < 0).all()


def test_exponential_schedule_decays_once_per_epoch():
    settings = TrainingSettings(schedule="exponential", peak_learning_rate=2e-4, epoch_decay=0.8)
    rates = [learning_rate(settings, step, 10) for step in range(30)]
    assert rates == pytest.approx([2e-4] * 10 + [1.6e-4] * 10 + [1.28e-4] * 10)


@pytest.mark.parametrize(
    "wrong",
    [
        {"epochs": 0},
        {"batch_size": 1},
        {"schedule": "cosine"},
        {"peak_learning_rate": 0.0},
        {"precision": "int8"},
        {"small_share": 1.5},
        {"small_scale": 0.0},
    ],
    ids=str,
)
def test_invalid_training_settings_are_refused_by_name(wrong):
    (name,) = wrong
    with pytest.raises(SettingsError, match=name):
        TrainingSettings(**wrong)


def test_members_of_different_settings_are_not_evaluated_together(data, uninterrupted, tmp_path):
    from deltasafe.perception.data.labeled_images import LabeledImageSet
    from deltasafe.perception.evaluate_and_freeze import evaluate_ensemble

    other = train_member(data, dataclasses.replace(SMALL, epochs=1), 8, tmp_path / "other", "cpu")
    with pytest.raises(SettingsError, match="different settings"):
        evaluate_ensemble(
            [uninterrupted, other],
            LabeledImageSet("none", (), (), ""),
            tmp_path / "report",
        )
    assert not (tmp_path / "report").exists()


def test_parallel_training_gives_same_losses_as_single_training(data, tmp_path):
    """With the same number of threads: sums in another order would differ."""
    from deltasafe.perception.data.augmentation.settings import AugmentationSettings
    from deltasafe.perception.data.augmented_set import augment_images
    from deltasafe.perception.data.labeled_images import LabeledImageSet
    from deltasafe.perception.training.train_ensemble import MemberJob, train_members

    hands = LabeledImageSet.load(pathlib.Path(__file__).parents[4] / "datasets" / "hands" / "train")
    few = dataclasses.replace(hands, items=hands.items[:4], pixel_digests=hands.pixel_digests[:4])
    stored = augment_images(few, tmp_path / "set", AugmentationSettings(n_variants=2, width=64, height=48), workers=1)
    settings = dataclasses.replace(SMALL, epochs=1)
    jobs = [MemberJob(f"member_{seed}", seed, tmp_path / f"side-{seed}") for seed in range(2)]
    reports = set()
    together = train_members(
        jobs,
        tmp_path / "set",
        settings,
        device="cpu",
        workers=2,
        on_step=lambda name, step: reports.add((name, step.step)),
    )
    assert reports == {(f"member_{seed}", step) for seed in range(2) for step in (1, 2)}
    n_threads = torch.get_num_threads()
    torch.set_num_threads(max(1, (os.cpu_count() or 1) // 2))
    try:
        alone = train_member(stored, settings, 1, tmp_path / "alone", "cpu")
    finally:
        torch.set_num_threads(n_threads)
    assert together["member_1"].losses == alone.losses
    assert together["member_0"].losses != alone.losses


def test_first_steps_see_area_averaged_small_images(data):
    batches = Batches(data, dataclasses.replace(SMALL, small_share=0.5, small_scale=0.5), seed=3)
    plain = Batches(data, dataclasses.replace(SMALL, small_share=0.0), seed=3)
    assert batches.n_steps == plain.n_steps == 8
    for step in range(batches.n_steps):
        (images, labels), (whole, mask) = (source.read(step, torch.device("cpu")) for source in (batches, plain))
        if step < 4:
            assert images.shape == (4, 3, 24, 32)
            assert torch.allclose(images, whole.float().unflatten(2, (24, 2)).unflatten(4, (32, 2)).mean((3, 5)))
            assert torch.allclose(labels.mean(), mask.mean())
        else:
            assert torch.equal(images, whole)
            assert torch.equal(labels, mask)


def test_epoch_contains_every_image_once(data):
    batches = Batches(data, dataclasses.replace(SMALL, small_share=0.0), seed=5)
    seen = [batches.read(step, torch.device("cpu"))[0] for step in range(batches.per_epoch)]
    pictures = {picture.numpy().tobytes() for batch in seen for picture in batch}
    assert pictures == {np.ascontiguousarray(picture.transpose(2, 0, 1)).tobytes() for picture in data.images}


def test_bfloat16_converts_dense_convolutions_only():
    images = torch.randint(0, 256, (2, 3, 48, 64), generator=torch.Generator().manual_seed(0))
    network = build_network(SMALL.network, 1).eval()
    with torch.no_grad():
        exact = network(images)
        convert_to_low_precision(network, "bfloat16", torch.device("cpu"))
        low = network(images)
    assert low.dtype == torch.float32
    assert not torch.equal(exact, low)
    assert (exact - low).abs().max() < 0.05 * exact.abs().max()
    changed = {module for module in network.modules() if type(module).__name__ == "_Bfloat16Convolution"}
    assert changed
    assert all(module.groups == 1 for module in changed)
