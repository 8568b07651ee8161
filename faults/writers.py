"""Everything that writes what must not be lost, small: each version bears its number, and is verified when read."""

import contextlib
import dataclasses
import functools
import pathlib
import shutil
import tempfile
from collections.abc import Callable, Iterator

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
from deltasafe.perception.settings import InferenceSettings, NetworkSettings, TrainingSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.train_member import train_member
from deltasafe.planning import ToolBody
from faults.ensemble import calibration_of_one, tiny_ensemble
from faults.killing import Writer, import_beforehand, run_alone
from faults.sets import tiny_hands, tiny_set
from pipelines.tracking.registry import EnsembleRegistry
from pipelines.tracking.tracker import MlflowTracker

__all__ = ["augmented_sets", "executions", "prepare", "prepared_writers", "writers"]

Say = Callable[[int], None]
STEPS = 4
"""Of the training of one member: 16 images in batches of 4."""


def prepare(sources: pathlib.Path) -> None:
    """Write what the writers start from: hands, a set of them, two frozen ensembles."""
    tiny_set(tiny_hands(sources / "hands"), sources / "set")
    for seed in (0, 1):
        tiny_ensemble(sources / str(seed), seed)


@contextlib.contextmanager
def prepared_writers() -> Iterator[tuple[pathlib.Path, list[Writer]]]:
    """All writers, and a home for what they write, which goes at the end."""
    with tempfile.TemporaryDirectory(prefix="deltasafe-faults-") as name:
        home = pathlib.Path(name)
        home.chmod(0o755)
        if said := run_alone(functools.partial(prepare, home / "sources")):
            raise RuntimeError(said)
        all_of_them = writers(home / "sources")
        for writer in all_of_them:
            if said := import_beforehand(functools.partial(_write_twice, writer, home / "beforehand" / writer.name)):
                raise RuntimeError(f"{writer.name} cannot even be written: {said}")
        shutil.rmtree(home / "beforehand")
        yield home, all_of_them


def _write_twice(writer: Writer, home: pathlib.Path) -> None:
    home.mkdir(parents=True)
    for number in (1, 1 + writer.per_run):
        writer.write(home, number, lambda done: None)
        writer.read(home)


def writers(sources: pathlib.Path) -> list[Writer]:
    """All of them, from what `prepare` wrote; nothing is computed that a forked child could not do once more."""
    frozen = [next((sources / str(seed) / "frozen").glob("ensemble-*")) for seed in (0, 1)]
    return [
        augmented_sets(sources / "hands"),
        _members(sources / "set"),
        _reports(),
        _ensembles(sources / "0" / "member"),
        _aliases(frozen),
        executions(),
    ]


def augmented_sets(hands: pathlib.Path) -> Writer:
    """Of always the same hands; the seed is the number."""

    def write(home: pathlib.Path, number: int, say: Say) -> None:
        tiny_set(hands, home / "set", seed=number, n_variants=2)
        say(number)

    def read(home: pathlib.Path) -> int:
        if not (home / "set").exists():
            return 0
        made = AugmentedSet.load(home / "set")
        made.verify()
        return made.settings.seed

    return Writer("augmented set", write, read)


def _members(data: pathlib.Path) -> Writer:
    """Of a member, every step counts: a checkpoint follows each."""
    settings = TrainingSettings(
        NetworkSettings(pretrained=False, pyramid_channels=8), epochs=1, batch_size=4, checkpoint_every_steps=1
    )

    def train(home: pathlib.Path, seed: int, say: Say) -> Member:
        torch.set_num_threads(1)
        before = seed * STEPS
        return train_member(
            AugmentedSet.load(data),
            settings,
            seed,
            home / f"member-{seed}",
            "cpu",
            lambda at: say(before + at.step - 1),
        )

    def write(home: pathlib.Path, number: int, say: Say) -> None:
        seed = (number - 1) // STEPS
        train(home, seed, say)
        say((seed + 1) * STEPS)

    def read(home: pathlib.Path) -> int:
        seeds = sorted(int(path.name.rpartition("-")[2]) for path in home.glob("member-*"))
        if not seeds:
            return 0
        for seed in seeds[:-1]:
            shutil.rmtree(home / f"member-{seed}")
        seed, folder = seeds[-1], home / f"member-{seeds[-1]}"
        if (folder / "member.json").is_file():
            member = Member.load(folder)
            apart = train(home / "apart", seed, lambda step: None)
            shutil.rmtree(home / "apart")
            if member.record["weights_sha256"] != apart.record["weights_sha256"]:
                raise ValueError(f"member {seed} differs from one that was never killed")
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


def _reports() -> Writer:
    rng = np.random.default_rng(0)
    labels = [np.where(np.arange(48 * 64).reshape(48, 64) % 64 < 20 + n, 255, 0).astype(np.uint8) for n in range(4)]
    guesses = [
        np.clip(label / 255 * 0.8 + 0.1 + rng.normal(0, 0.05, (2, 48, 64)), 0.01, 0.99).astype(np.float32)
        for label in labels
    ]
    images = LabeledPredictions([f"image_{n}" for n in range(4)], labels, guesses)
    made = evaluate(images, CalibrationSettings(n_bootstrap=100))

    def write(home: pathlib.Path, number: int, say: Say) -> None:
        named = dataclasses.replace(made, image_ids=tuple(f"{number}_{n}" for n in range(4)))
        write_calibration_report(home / "report", named, dataclasses.replace(images, image_ids=named.image_ids))
        say(number)

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
            raise ValueError("report.md is of another version than report.json")
        return numbers.pop()

    return Writer("report", write, read)


def _ensembles(member: pathlib.Path) -> Writer:
    golden = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)

    def write(home: pathlib.Path, number: int, say: Say) -> None:
        torch.set_num_threads(1)
        made = [Member.load(member)]
        about = {"number": str(number)}
        write_frozen_ensemble(made, InferenceSettings(64, 48), calibration_of_one(), golden, home / "frozen", about)
        say(number)

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


def _aliases(frozen: list[pathlib.Path]) -> Writer:
    """Two ensembles are put in use in turns; MLflow's database and the note beside it must agree."""

    def registry(home: pathlib.Path) -> EnsembleRegistry:
        for folder in frozen:
            if not (home / "frozen" / folder.name).exists():
                shutil.copytree(folder, home / "frozen" / folder.name)
        return EnsembleRegistry(MlflowTracker(home))

    def write(home: pathlib.Path, number: int, say: Say) -> None:
        made = registry(home)
        folder = home / "frozen" / frozen[number % 2].name
        made.tracker.register(f"{number % 2}" * 64, folder)
        made.decide(folder, True, f"number {number}")
        say(number)

    def read(home: pathlib.Path) -> int:
        if not (home / "champion.json").exists():
            return 0
        made = registry(home)
        folder = made.champion()
        if made.tracker.pending.files() or any((home / "mlflow" / "pending" / "refused").glob("*")):
            raise ValueError("a call could not be made again")
        reasons = [version.tags.get("promoted", "") for version in made.versions() if "champion" in version.aliases]
        numbers = [int(reason.rpartition(" ")[2]) for reason in reasons]
        if len(numbers) > 1 or (numbers and (folder is None or folder.name != frozen[numbers[0] % 2].name)):
            raise ValueError(f"{folder} is in use, the registry says {reasons}")
        if folder is not None:
            verify_artifact(folder)
        return numbers[0] if numbers else 0

    return Writer("registry alias", write, read)


def executions() -> Writer:
    """A folder, and a log of it."""
    count = 200

    def write(home: pathlib.Path, number: int, say: Say) -> None:
        rng = np.random.default_rng(number)
        made = Execution(
            reference_poses=np.zeros((count, 4)),
            reference_velocities=np.zeros((count, 4)),
            time_s=np.arange(count) / 100,
            phase=np.repeat([0, 2, 4, 4], count // 4),
            tool_positions_m=rng.normal(size=(count, 3)),
            tool_quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
            joint_positions_rad=rng.normal(size=(count, 7)),
            torques_nm=rng.normal(size=(count, 7)),
            tool_to_hand_m=np.ones(count),
            arm_to_hand_m=np.ones(count),
            contacts=np.zeros(count, np.int32),
            body=ToolBody(),
            seed=number,
        )
        made.save(home / "execution")
        say(number)
        export_execution(made, home / "execution.mcap")

    def read(home: pathlib.Path) -> int:
        if not (home / "execution").exists():
            return 0
        found = Execution.load(home / "execution")
        log = home / "execution.mcap"
        if log.exists() and not found.seed - 2 <= import_execution(log).seed <= found.seed:
            raise ValueError("the log is not of the execution, nor of the one before")
        return found.seed

    return Writer("execution log", write, read)
