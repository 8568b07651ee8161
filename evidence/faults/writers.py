"""Writers of every artifact that must survive a crash. Each stores numbered versions and verifies them on reading."""

import contextlib
import dataclasses
import functools
import pathlib
import shutil
from collections.abc import Iterator

import numpy as np
import torch

from deltasafe.execution import Execution
from deltasafe.interchange.executions import export_execution, import_execution
from deltasafe.perception.artifact.frozen_ensemble import verify_artifact, write_frozen_ensemble
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings
from deltasafe.perception.calibration.write_report import write_calibration_report
from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.settings import NetworkSettings, TrainingSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.train_member import train_member
from evidence.faults.children import Commit, Writer, ignore, preload_imports, run_in_child
from evidence.fixtures import (
    TINY_INFERENCE,
    calibration,
    synthetic_execution,
    temporary_home,
    tiny_ensemble,
    tiny_hands,
    tiny_set,
)
from pipelines.tracking.registry import EnsembleRegistry
from pipelines.tracking.tracker import MlflowTracker

REGISTRY_ALIAS = "registry alias"
STEPS = 4
"""Training steps of one member: 16 images in batches of 4."""


@contextlib.contextmanager
def prepared_writers() -> Iterator[tuple[pathlib.Path, list[Writer]]]:
    """Yield a temporary folder and all writers, with their inputs written and their imports loaded."""
    with temporary_home() as home:
        if failure := run_in_child(functools.partial(_write_sources, home / "sources")):
            raise RuntimeError(failure)
        writers = _all_writers(home / "sources")
        for writer in writers:
            if failure := preload_imports(functools.partial(_write_twice, writer, home / "practice" / writer.name)):
                raise RuntimeError(f"{writer.name} cannot be written: {failure}")
        shutil.rmtree(home / "practice")
        yield home, writers


def _write_sources(sources: pathlib.Path) -> None:
    tiny_set(tiny_hands(sources / "hands"), sources / "set")
    for seed in (0, 1):
        tiny_ensemble(sources / str(seed), seed)


def _write_twice(writer: Writer, home: pathlib.Path) -> None:
    home.mkdir(parents=True)
    for number in (1, 1 + writer.per_run):
        writer.write(home, number, ignore)
        writer.read(home)


def _all_writers(sources: pathlib.Path) -> list[Writer]:
    frozen = [next((sources / str(seed) / "frozen").glob("ensemble-*")) for seed in (0, 1)]
    return [
        augmented_set_writer(sources / "hands"),
        _member_writer(sources / "set"),
        _report_writer(),
        _ensemble_writer(sources / "0" / "member-0"),
        _alias_writer(frozen),
        execution_writer(),
    ]


def augmented_set_writer(hands: pathlib.Path) -> Writer:
    """Write augmented sets of the same images; the seed is the version number."""

    def write(home: pathlib.Path, number: int, commit: Commit) -> None:
        tiny_set(hands, home / "set", seed=number, n_variants=2)
        commit(number)

    def read(home: pathlib.Path) -> int:
        if not (home / "set").exists():
            return 0
        made = AugmentedSet.load(home / "set")
        made.verify()
        return made.settings.seed

    return Writer("augmented set", write, read)


def _member_writer(data: pathlib.Path) -> Writer:
    """Train members with a checkpoint after every step; every step is a version."""
    settings = TrainingSettings(
        NetworkSettings(pretrained=False, pyramid_channels=8), epochs=1, batch_size=4, checkpoint_every_steps=1
    )

    def train(home: pathlib.Path, seed: int, commit: Commit) -> Member:
        torch.set_num_threads(1)
        folder, before = home / f"member-{seed}", seed * STEPS
        return train_member(
            AugmentedSet.load(data), settings, seed, folder, "cpu", lambda at: commit(before + at.step - 1)
        )

    def write(home: pathlib.Path, number: int, commit: Commit) -> None:
        seed = (number - 1) // STEPS
        train(home, seed, commit)
        commit((seed + 1) * STEPS)

    def read(home: pathlib.Path) -> int:
        seeds = sorted(int(path.name.rpartition("-")[2]) for path in home.glob("member-*"))
        if not seeds:
            return 0
        for seed in seeds[:-1]:
            shutil.rmtree(home / f"member-{seed}")
        seed, folder = seeds[-1], home / f"member-{seeds[-1]}"
        if (folder / "member.json").is_file():
            member = Member.load(folder)
            reference = train(home / "reference", seed, ignore)
            shutil.rmtree(home / "reference")
            if member.record["weights_sha256"] != reference.record["weights_sha256"]:
                raise ValueError(f"member {seed} differs from a member that was trained without interruption")
            return seed * STEPS + len(member.losses)
        return seed * STEPS + _steps_in(folder / "checkpoint.safetensors")

    return Writer("member", write, read, STEPS)


def _steps_in(checkpoint: pathlib.Path) -> int:
    from safetensors import safe_open

    if not checkpoint.is_file():
        return 0
    with safe_open(checkpoint, framework="numpy") as file:
        for key in file.keys():  # noqa: SIM118
            file.get_tensor(key)
        return len(file.get_tensor("losses"))


def _report_writer() -> Writer:
    rng = np.random.default_rng(0)
    labels = [np.where(np.arange(48 * 64).reshape(48, 64) % 64 < 20 + n, 255, 0).astype(np.uint8) for n in range(4)]
    predictions = [
        np.clip(label / 255 * 0.8 + 0.1 + rng.normal(0, 0.05, (2, 48, 64)), 0.01, 0.99).astype(np.float32)
        for label in labels
    ]
    images = LabeledPredictions([f"image_{n}" for n in range(4)], labels, predictions)
    made = evaluate(images, CalibrationSettings(n_bootstrap=100))

    def write(home: pathlib.Path, number: int, commit: Commit) -> None:
        named = dataclasses.replace(made, image_ids=tuple(f"{number}_{n}" for n in range(4)))
        write_calibration_report(home / "report", named, dataclasses.replace(images, image_ids=named.image_ids))
        commit(number)

    def read(home: pathlib.Path) -> int:
        if not (home / "report").exists():
            return 0
        found = CalibrationReport.load(home / "report")
        numbers = {int(name.partition("_")[0]) for name in found.image_ids}
        text = (home / "report" / "report.md").read_text(encoding="utf-8")
        pictures = [path.read_bytes() for path in (home / "report").glob("*.png")]
        if len(numbers) != 1 or len(pictures) < 3 or not all(b"IEND" in data[-12:] for data in pictures):
            raise ValueError("the report is incomplete")
        if f"{min(numbers)}_0" not in text:
            raise ValueError("report.md and report.json are of different versions")
        return numbers.pop()

    return Writer("report", write, read)


def _ensemble_writer(member: pathlib.Path) -> Writer:
    golden = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)

    def write(home: pathlib.Path, number: int, commit: Commit) -> None:
        torch.set_num_threads(1)
        made = [Member.load(member)]
        about = {"number": str(number)}
        write_frozen_ensemble(made, TINY_INFERENCE, calibration(1), golden, home / "frozen", about)
        commit(number)

    def read(home: pathlib.Path) -> int:
        numbers = {0: home}
        for folder in (home / "frozen").glob("*"):
            if not folder.name.startswith("."):
                numbers[int(verify_artifact(folder)["provenance"]["number"])] = folder
        for number, folder in numbers.items():
            if 0 < number < max(numbers):
                shutil.rmtree(folder)
        return max(numbers)

    return Writer("frozen ensemble", write, read)


def _alias_writer(frozen: list[pathlib.Path]) -> Writer:
    """Promote two ensembles in turn; MLflow's database and the file ``champion.json`` must agree."""

    def registry(home: pathlib.Path) -> EnsembleRegistry:
        for folder in frozen:
            if not (home / "frozen" / folder.name).exists():
                shutil.copytree(folder, home / "frozen" / folder.name)
        return EnsembleRegistry(MlflowTracker(home))

    def write(home: pathlib.Path, number: int, commit: Commit) -> None:
        made = registry(home)
        folder = home / "frozen" / frozen[number % 2].name
        made.tracker.register(f"{number % 2}" * 64, folder)
        made.decide(folder, True, f"number {number}")
        commit(number)

    def read(home: pathlib.Path) -> int:
        if not (home / "champion.json").exists():
            return 0
        made = registry(home)
        folder = made.champion()
        if made.tracker.pending.files() or any((home / "mlflow" / "pending" / "refused").glob("*")):
            raise ValueError("a queued call could not be replayed")
        reasons = [version.tags.get("promoted", "") for version in made.versions() if "champion" in version.aliases]
        numbers = [int(reason.rpartition(" ")[2]) for reason in reasons]
        if len(numbers) > 1 or (numbers and (folder is None or folder.name != frozen[numbers[0] % 2].name)):
            raise ValueError(f"the champion is {folder}, but the registry has {reasons}")
        if folder is not None:
            verify_artifact(folder)
        return numbers[0] if numbers else 0

    return Writer(REGISTRY_ALIAS, write, read)


def execution_writer() -> Writer:
    """Write an execution folder and then a log of it."""

    def write(home: pathlib.Path, number: int, commit: Commit) -> None:
        made = synthetic_execution(200, number)
        made.save(home / "execution")
        commit(number)
        export_execution(made, home / "execution.mcap")

    def read(home: pathlib.Path) -> int:
        if not (home / "execution").exists():
            return 0
        found = Execution.load(home / "execution")
        log = home / "execution.mcap"
        if log.exists() and not found.seed - 2 <= import_execution(log).seed <= found.seed:
            raise ValueError("the log belongs neither to the stored execution nor to one of the two before it")
        return found.seed

    return Writer("execution log", write, read)
