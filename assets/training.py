"""Members trained, seen in Dagster's log, and recorded with the tracker."""

import dataclasses
import pathlib
from collections.abc import Mapping

import dagster as dg

from assets.interfaces import Store, Tracker, TrainedMember
from assets.progress import progress_of
from assets.reporting import folder_facts, inline_picture, page_link
from deltasafe.compute.executor import Executor
from deltasafe.perception.settings import TrainingSettings

__all__ = ["Training", "train_and_record"]


@dataclasses.dataclass(frozen=True)
class Training:
    """Where members are trained, and how many side by side."""

    device: str
    workers: int
    executor: Executor


def train_and_record(
    context: dg.AssetExecutionContext,
    seeds: Mapping[str, int],
    augmented: pathlib.Path,
    settings: TrainingSettings,
    where: Training,
    store: Store,
    tracker: Tracker,
) -> dict[str, pathlib.Path]:
    """Folders of the members by name.

    A folder's name is the digest of what determines the member, so a second run finds it finished.
    """
    from deltasafe.perception.data.augmented_set import AugmentedSet
    from deltasafe.perception.training.loss_figure import loss_curves
    from deltasafe.perception.training.train_ensemble import MemberJob, train_members
    from deltasafe.perception.training.train_member import StepReport, training_identity

    data = AugmentedSet.load(augmented)
    jobs = [
        MemberJob(name, seed, store.folder("ensemble_member", training_identity(data, settings, seed)[:16]))
        for name, seed in seeds.items()
    ]
    said = {name: progress_of(context, every_s=20.0) for name in seeds}
    speeds: dict[str, dict[int, float]] = {name: {} for name in seeds}

    def on_step(name: str, step: StepReport) -> None:
        speeds[name][step.epoch] = step.images_per_s
        left_min = (step.n_steps - step.step) * settings.batch_size / step.images_per_s / 60
        text = f"{name}: epoch {step.epoch} of {settings.epochs}, loss {step.loss:.3f}"
        said[name](step.step, step.n_steps, f"{text}, {step.images_per_s:.1f} images/s, {left_min:.1f} min left")

    trained = train_members(
        jobs,
        augmented,
        settings,
        device=where.device,
        workers=where.workers,
        on_step=on_step,
        executor=where.executor,
    )
    for name, member in trained.items():
        losses, curve, per_epoch = member.losses, member.folder / "loss.png", member.record["steps_per_epoch"]
        loss_curves({name: losses}, per_epoch, curve)
        page = tracker.member(
            member.ensemble_identity,
            TrainedMember(
                name,
                {**_flat(settings), "seed": member.seed},
                losses,
                per_epoch,
                [speed for _, speed in sorted(speeds[name].items())],
                {"augmented hands": data.digest},
                curve,
            ),
        )
        final = round(sum(losses[-20:]) / len(losses[-20:]), 4)
        metadata = {
            "loss": inline_picture(curve),
            "final loss": final,
            "steps": len(losses),
            "seed": member.seed,
        }
        facts = folder_facts(member.folder, member.record["weights_sha256"][:16])
        context.add_asset_metadata({**metadata, **page_link(page), **facts}, partition_key=name)
        context.log.info(f"{name}: finished after {len(losses)} steps, loss {final:.3f}")
    return {name: member.folder for name, member in trained.items()}


def _flat(settings: TrainingSettings) -> dict[str, object]:
    """Parameters for the tracker, nested names joined by a dot."""
    flat: dict[str, object] = {}
    for key, value in dataclasses.asdict(settings).items():
        flat |= {f"{key}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
    return flat
