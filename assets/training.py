"""Train members, log their progress in Dagster, and record them with the tracker."""

import dataclasses
import pathlib
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

import dagster as dg

from assets.interfaces import Store, Tracker, TrainedMember
from assets.progress import progress_of
from assets.reporting import folder_facts, inline_picture, page_link
from deltasafe.compute.executor import Executor
from deltasafe.perception.settings import TrainingSettings

if TYPE_CHECKING:
    from deltasafe.perception.training.member import Member
    from deltasafe.perception.training.train_member import StepReport


@dataclasses.dataclass(frozen=True)
class Training:
    """Settings of a training, and the objects that it uses.

    Attributes:
        settings: settings of the members.
        device: device of torch, or ``auto``.
        workers: number of members that are trained in parallel; 0 means one per core.
        store, tracker, executor: see `assets.interfaces` and `deltasafe.compute.executor`.
    """

    settings: TrainingSettings
    device: str
    workers: int
    store: Store
    tracker: Tracker
    executor: Executor

    def run(
        self, context: dg.AssetExecutionContext, seeds: Mapping[str, int], augmented: pathlib.Path
    ) -> dict[str, pathlib.Path]:
        """Train one member per seed; return their folders by name.

        A folder is named by a digest of settings, data and seed, so a finished member is found again.
        """
        from deltasafe.perception.data.augmented_set import AugmentedSet
        from deltasafe.perception.training.train_ensemble import MemberJob, train_members
        from deltasafe.perception.training.train_member import training_identity

        data = AugmentedSet.load(augmented)
        jobs = [
            MemberJob(
                name,
                seed,
                self.store.folder("ensemble_member", training_identity(data, self.settings, seed)[:16]),
            )
            for name, seed in seeds.items()
        ]
        log = _StepLog(context, self.settings, seeds)
        trained = train_members(
            jobs,
            augmented,
            self.settings,
            device=self.device,
            workers=self.workers,
            on_step=log.on_step,
            executor=self.executor,
        )
        for name, member in trained.items():
            self._record(context, name, member, log, {f"augmented {data.info.plural}": data.digest})
        return {name: member.folder for name, member in trained.items()}

    def _record(
        self,
        context: dg.AssetExecutionContext,
        name: str,
        member: "Member",
        log: "_StepLog",
        data: Mapping[str, str],
    ) -> None:
        from deltasafe.perception.training.loss_figure import plot_loss_curves

        losses, curve, per_epoch = member.losses, member.folder / "loss.png", member.record["steps_per_epoch"]
        plot_loss_curves({name: losses}, per_epoch, curve)
        parameters = {**_flat(self.settings), "seed": member.seed}
        speeds, times_ms = [speed for _, speed in sorted(log.images_per_s[name].items())], log.trained_ms.get(name)
        page = self.tracker.member(
            member.ensemble_identity,
            TrainedMember(name, parameters, losses, per_epoch, speeds, data, curve, times_ms),
        )
        final = round(sum(losses[-20:]) / len(losses[-20:]), 4)
        metadata = {"loss": inline_picture(curve), "final loss": final, "steps": len(losses), "seed": member.seed}
        facts = folder_facts(member.folder, member.record["weights_sha256"][:16])
        context.add_asset_metadata({**metadata, **page_link(page), **facts}, partition_key=name)
        context.log.info(f"{name}: finished after {len(losses)} steps, loss {final:.3f}")


class _StepLog:
    """Logs steps with their speed and the remaining time.

    Attributes:
        images_per_s: training speed at the end of every epoch, by member and epoch.
        losses: losses of the present epoch, by member. After each epoch, an observation of the asset shows their mean.
        trained_ms: first and last step of each member that was trained here, in Unix milliseconds.
    """

    def __init__(self, context: dg.AssetExecutionContext, settings: TrainingSettings, seeds: Mapping[str, int]) -> None:
        self._settings, self._context = settings, context
        self._progress = {name: progress_of(context, every_s=20.0) for name in seeds}
        self.images_per_s: dict[str, dict[int, float]] = {name: {} for name in seeds}
        self.losses: dict[str, list[float]] = {name: [] for name in seeds}
        self.trained_ms: dict[str, tuple[int, int]] = {}

    def on_step(self, name: str, step: "StepReport") -> None:
        self.images_per_s[name][step.epoch] = step.images_per_s
        now_ms = int(1000 * time.time())
        self.trained_ms[name] = (self.trained_ms.get(name, (now_ms, now_ms))[0], now_ms)
        left_min = (step.n_steps - step.step) * self._settings.batch_size / step.images_per_s / 60
        text = f"{name}: epoch {step.epoch} of {self._settings.epochs}, loss {step.loss:.3f}"
        text = f"{text}, {step.images_per_s:.1f} images/s, {left_min:.1f} min left"
        self._progress[name](step.step, step.n_steps, text)
        self.losses[name].append(step.loss)
        if step.step * self._settings.epochs % step.n_steps == 0:
            self._end_of_epoch(name, step)

    def _end_of_epoch(self, name: str, step: "StepReport") -> None:
        losses = self.losses[name]
        metadata = {
            "epoch": step.epoch,
            "loss of the epoch": sum(losses) / len(losses),
            "images/s": round(step.images_per_s, 2),
        }
        self._context.log_event(dg.AssetObservation(self._context.asset_key, partition=name, metadata=metadata))
        losses.clear()


def _flat(settings: TrainingSettings) -> dict[str, object]:
    """Flatten nested settings; their names are joined by a dot."""
    flat: dict[str, object] = {}
    for key, value in dataclasses.asdict(settings).items():
        flat |= {f"{key}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
    return flat
