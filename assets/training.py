"""One member trained, seen in Dagster's log, and recorded with the tracker."""

import pathlib

import dagster as dg

from assets.interfaces import Store, Tracker
from assets.progress import progress_of
from assets.reporting import inline_picture
from deltasafe.perception.settings import TrainingSettings

__all__ = ["train_and_record"]


def train_and_record(
    context: dg.AssetExecutionContext,
    name: str,
    augmented: pathlib.Path,
    settings: TrainingSettings,
    seed: int,
    device: str,
    store: Store,
    tracker: Tracker,
) -> pathlib.Path:
    """Folder of the member; its name is the digest of what determines it, so a second run finds it finished."""
    from deltasafe.figures.training import loss_curves
    from deltasafe.perception.augmented_set import AugmentedSet
    from deltasafe.perception.training import StepReport, train_member, training_identity

    data = AugmentedSet.load(augmented)
    folder = store.folder("ensemble_member", training_identity(data, settings, seed)[:16])
    progress = progress_of(context, every_s=15.0)

    def on_step(step: StepReport) -> None:
        left_s = (step.n_steps - step.step) * settings.batch_size / step.images_per_s
        progress(
            step.step,
            step.n_steps,
            f"{name}: epoch {step.epoch} of {settings.epochs}, loss {step.loss:.3f}, "
            f"{step.images_per_s:.1f} images/s, {left_s / 60:.1f} min left",
        )

    member = train_member(data, settings, seed, folder, device, on_step)
    losses = member.losses
    loss_curves({name: losses}, member.record["steps_per_epoch"], folder / "loss.png")
    tracker.member(member.ensemble_identity, name, {**settings_of(settings), "seed": seed}, losses)
    final = sum(losses[-20:]) / len(losses[-20:])
    context.add_asset_metadata(
        {
            "seed": seed,
            "final loss": final,
            "steps": len(losses),
            "loss": inline_picture(folder / "loss.png"),
        },
        partition_key=name,
    )
    return folder


def settings_of(settings: TrainingSettings) -> dict[str, object]:
    """Flat parameters for the tracker, nested names joined by a dot."""
    import dataclasses

    flat: dict[str, object] = {}
    for key, value in dataclasses.asdict(settings).items():
        if isinstance(value, dict):
            flat |= {f"{key}.{inner}": item for inner, item in value.items()}
        else:
            flat[key] = value
    return flat
