"""From fifty labelled images to a frozen ensemble."""

import pathlib

import dagster as dg

from assets.config import configurable
from assets.interfaces import Store, Tracker
from assets.progress import progress_of
from assets.reporting import Metadata, inline_picture, inline_report
from deltasafe import presets

PRESET = presets.active()
GROUP = "perception"
OWNERS = ["team:perception"]

members = dg.StaticPartitionsDefinition([f"member_{index:02d}" for index in range(PRESET.n_members)])

AugmentationConfig = configurable(PRESET.augmentation)
TrainingConfig = configurable(PRESET.training)
InferenceConfig = configurable(PRESET.inference)
CalibrationConfig = configurable(PRESET.calibration)


class HandsConfig(dg.Config):
    """`folder` holds images/ and masks/ (255 = hand); empty for the packaged set."""

    folder: str = ""


class AugmentedConfig(dg.Config):
    """`backgrounds` is a folder of pictures without hands; empty for the packaged ones."""

    augmentation: AugmentationConfig = AugmentationConfig()
    backgrounds: str = ""
    workers: int = 2


class MemberConfig(dg.Config):
    """Member m is trained with the seed `first_seed` + m; `workers` = 0 is one process a core."""

    training: TrainingConfig = TrainingConfig()
    first_seed: int = 0
    device: str = "auto"
    workers: int = 0


class ReportConfig(dg.Config):
    """How the ensemble looks at the test images, and how its report is computed.

    `calibration_folder` holds further labelled images (images/, masks/) to fit temperature, delta and threshold on;
    empty to fit and judge on the test images in turn.
    """

    inference: InferenceConfig = InferenceConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    calibration_folder: str = ""
    device: str = "auto"


def _checked(config: HandsConfig, store: Store, packaged: str) -> dg.Output[pathlib.Path]:
    from deltasafe.perception.hands import HandSet

    folder, registry = store.dataset(config.folder, packaged)
    hands = HandSet.load(folder, registry)
    return dg.Output(folder, metadata={"images": len(hands), "digest": hands.digest, "folder": str(folder)})


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"image"}, code_version="1")
def raw_hands(config: HandsConfig, store: dg.ResourceParam[Store]) -> dg.Output[pathlib.Path]:
    """The labelled training images: few, and of low variety. Checked file by file before anything uses them."""
    return _checked(config, store, "hands/train")


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"image"}, code_version="1")
def test_hands(config: HandsConfig, store: dg.ResourceParam[Store]) -> dg.Output[pathlib.Path]:
    """Labelled images of high variety. They enter at the calibration report and nowhere before."""
    return _checked(config, store, "hands/test")


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"numpy", "image"}, code_version="1")
def augmented_hands(
    context: dg.AssetExecutionContext,
    config: AugmentedConfig,
    raw_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """Twenty new images of each original: background replaced, seven more methods with p = 0.5 each."""
    from deltasafe.figures.contact_sheet import contact_sheet
    from deltasafe.perception.augmented_set import write_augmented_set
    from deltasafe.perception.hands import HandSet

    hands = HandSet.load(raw_hands)
    backgrounds, _ = store.dataset(config.backgrounds, "backgrounds")
    folder = store.folder("augmented_hands", context.run_id[:8])
    settings, progress = config.augmentation.settings(), progress_of(context)
    made = write_augmented_set(hands, backgrounds, settings, folder, workers=config.workers, progress=progress)
    sheet = folder.with_name(f"{folder.name}-sheet.png")
    contact_sheet(hands, made, sheet)
    metadata: Metadata = {"images": made.n, "digest": made.digest, "contact sheet": inline_picture(sheet)}
    return dg.Output(folder, metadata=metadata)


@dg.asset(
    group_name=GROUP,
    owners=OWNERS,
    kinds={"pytorch"},
    code_version="1",
    partitions_def=members,
    backfill_policy=dg.BackfillPolicy.single_run(),
)
def ensemble_member(
    context: dg.AssetExecutionContext,
    config: MemberConfig,
    augmented_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
    tracker: dg.ResourceParam[Tracker],
) -> dict[str, pathlib.Path]:
    """Networks trained independently: own random head, own shuffling. An interrupted training is resumed."""
    from assets.training import train_and_record

    everyone = members.get_partition_keys()
    seeds = {name: config.first_seed + everyone.index(name) for name in sorted(context.partition_keys)}
    settings = config.training.settings()
    return train_and_record(context, seeds, augmented_hands, settings, config.device, config.workers, store, tracker)


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"pytorch", "markdown"}, code_version="1")
def calibration_report(
    context: dg.AssetExecutionContext,
    config: ReportConfig,
    ensemble_member: dict[str, pathlib.Path],
    raw_hands: pathlib.Path,
    test_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
    tracker: dg.ResourceParam[Tracker],
) -> dg.Output[pathlib.Path]:
    """May the mean of the members be called a probability? Judged on all pixels of the test images."""
    from deltasafe.perception.ensemble_evaluation import evaluate_members
    from deltasafe.perception.hands import HandSet, check_disjoint
    from deltasafe.perception.member import Member

    trained = [Member.load(folder) for _, folder in sorted(ensemble_member.items())]
    calibration = None
    if config.calibration_folder:
        calibration = HandSet.load(config.calibration_folder)
        check_disjoint(HandSet.load(raw_hands), calibration)
    folder = store.folder("calibration_report", context.run_id[:8])
    report = evaluate_members(
        trained,
        HandSet.load(test_hands),
        folder,
        inference=config.inference.settings(),
        settings=config.calibration.settings(),
        planning_delta=PRESET.motion.delta,
        device=config.device,
        progress=progress_of(context),
        calibration=calibration,
    )
    tracker.report(trained[0].ensemble_identity, report.figures(), folder)
    metadata: Metadata = {"report": inline_report(folder / "report.md"), **report.figures(), "folder": str(folder)}
    return dg.Output(folder, metadata=metadata)


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"pytorch", "onnx"}, code_version="1")
def frozen_ensemble(
    context: dg.AssetExecutionContext,
    ensemble_member: dict[str, pathlib.Path],
    calibration_report: pathlib.Path,
    raw_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
    tracker: dg.ResourceParam[Tracker],
) -> dg.Output[pathlib.Path]:
    """The ensemble as a folder named by its content, which other projects pull; registered with an alias."""
    from deltasafe.perception.ensemble_evaluation import freeze_evaluated
    from deltasafe.perception.hands import HandSet
    from deltasafe.perception.member import Member

    trained = [Member.load(folder) for _, folder in sorted(ensemble_member.items())]
    golden_rgb, _ = HandSet.load(raw_hands).read(0)
    folder = freeze_evaluated(trained, calibration_report, golden_rgb, store.home / "frozen")
    uri = tracker.register(trained[0].ensemble_identity, folder, {"dagster_run_id": context.run_id})
    card = (folder / "model_card.md").read_text(encoding="utf-8")
    metadata: Metadata = {"folder": str(folder), "model": uri, "model card": dg.MetadataValue.md(card)}
    return dg.Output(folder, metadata=metadata)
