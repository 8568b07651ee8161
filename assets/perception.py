"""Perception: from labeled images to a frozen ensemble."""

import dataclasses
import functools
import pathlib
from typing import TYPE_CHECKING, Any

import dagster as dg

from assets.config import configurable
from assets.interfaces import Registry, Store, Tracker
from assets.policies import ALL_CORES, RETRY_TWICE, no_retry
from assets.progress import progress_of
from assets.promotion import NOT_WORSE, not_worse, verdict_table
from assets.reporting import (
    folder_facts,
    inline_jpeg,
    inline_picture,
    page_link,
    readable,
    report_with_summary,
)
from assets.run_settings import planning_delta
from deltasafe import presets
from deltasafe.compute.executor import Executor
from deltasafe.errors import SettingsError
from deltasafe.perception.data.importing.settings import ImportSettings

if TYPE_CHECKING:
    from deltasafe.perception.data.labeled_images import LabeledImageSet

PRESET = presets.active()
_asset = functools.partial(dg.asset, group_name="perception", owners=["team:perception"], code_version="1")
_retried = functools.partial(_asset, retry_policy=RETRY_TWICE)

members = dg.StaticPartitionsDefinition([f"member_{index:02d}" for index in range(PRESET.n_members)])

LabelsConfig = configurable(ImportSettings())
AugmentationConfig = configurable(PRESET.augmentation)
TrainingConfig = configurable(PRESET.training)
InferenceConfig = configurable(PRESET.inference)
CalibrationConfig = configurable(PRESET.calibration)
PromotionConfig = configurable(PRESET.promotion)


class HandsConfig(dg.Config):
    """`folder` contains images/ and masks/ (255 = obstacle). If it is empty, the packaged set is used.

    Or `source` is the label file or folder of another tool, and `labels` says how to convert it.
    """

    folder: str = ""
    source: str = ""
    labels: LabelsConfig = LabelsConfig()

    def input(self, store: Store, asset: str, packaged: str) -> tuple[pathlib.Path, pathlib.Path | None]:
        """Return folder and checksum registry of the set; converts the source if that is not done yet.

        Raises:
            DataError: the source cannot be converted.
            SettingsError: both folder and source are given, or the settings of the labels are invalid.
        """
        from deltasafe.perception.data.importing.import_hands import import_hands, source_digest

        if not self.source:
            return store.dataset(self.folder, packaged)
        if self.folder:
            raise SettingsError(f"{asset}: give either folder or source, not both")
        source, settings = pathlib.Path(self.source).expanduser(), self.labels.settings()
        converted = store.folder(asset, f"import-{source_digest(source, settings)[:16]}")
        if not converted.is_dir():
            import_hands(source, converted, settings)
        return converted, None


class AugmentedConfig(dg.Config):
    """`backgrounds` is a folder of pictures without obstacles. If it is empty, the packaged ones are used."""

    augmentation: AugmentationConfig = AugmentationConfig()
    backgrounds: str = ""
    workers: int = 2


class MemberConfig(dg.Config):
    """Member m is trained with the seed `first_seed` + m. `workers` = 0 trains one member per core in parallel."""

    training: TrainingConfig = TrainingConfig()
    first_seed: int = 0
    device: str = "auto"
    workers: int = 0


class ReportConfig(dg.Config):
    """Settings of inference and of the report.

    `calibration_folder` contains further labeled images (images/, masks/) to fit temperature, delta and threshold on.
    If it is empty, they are fitted and evaluated on the test images by cross-validation.
    """

    inference: InferenceConfig = InferenceConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    calibration_folder: str = ""
    device: str = "auto"


def _checked_hands(config: HandsConfig, store: Store, asset: str, packaged: str) -> dg.Output[pathlib.Path]:
    from deltasafe.perception.data.labeled_images import LabeledImageSet, check_distinct
    from deltasafe.perception.data.labeled_images_figure import labeled_images_figure
    from deltasafe.perception.data.near_copies import listed, near_copies

    folder, registry = config.input(store, asset, packaged)
    hands = LabeledImageSet.load(folder, registry)
    if asset == "test_hands":
        check_distinct(hands, "test")
    sheet = inline_jpeg(labeled_images_figure(hands), "labeled images")
    facts = {"images": len(hands), "obstacle": hands.info.singular, **folder_facts(folder, hands.digest[:16])}
    metadata: dict[str, Any] = {"examples": sheet, **facts}
    metadata |= {"images without a hand": len(hands.without_hand)} if hands.without_hand else {}
    if hands.copies:
        copies = "; ".join(f"{item.image.name} of {first.image.name}" for item, first in hands.copies)
        dg.get_dagster_logger().warning(f"copies count twice in training, remove them if that is not meant: {copies}")
        metadata["copies"] = copies
    if asset == "test_hands" and (pairs := near_copies(hands)):
        metadata["near copies"] = listed(pairs)
        dg.get_dagster_logger().warning(f"near copies count twice as evidence, keep one of each: {listed(pairs)}")
    if config.source:
        metadata["conversion"] = dg.MetadataValue.md((folder / "import.md").read_text(encoding="utf-8"))
    return dg.Output(folder, metadata=metadata, data_version=dg.DataVersion(hands.digest[:16]))


@_asset(kinds={"image"})
@no_retry
def raw_hands(config: HandsConfig, store: dg.ResourceParam[Store]) -> dg.Output[pathlib.Path]:
    """Labeled training images (image and mask). Every file is checked; the asset is the folder that contains them.

    A failure names the file and the defect.
    """
    return _checked_hands(config, store, "raw_hands", "hands/train")


@_asset(kinds={"image"})
@no_retry
def test_hands(config: HandsConfig, store: dg.ResourceParam[Store]) -> dg.Output[pathlib.Path]:
    """Labeled test images. Only the calibration report, the comparison with the champion and the studies use them.

    A failure names the file and the defect.
    """
    return _checked_hands(config, store, "test_hands", "hands/test")


@_retried(kinds={"numpy", "image"}, pool=ALL_CORES)
@no_retry
def augmented_hands(
    context: dg.AssetExecutionContext,
    config: AugmentedConfig,
    raw_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """New training images from each original: the background is replaced, and further methods apply at random.

    Made from raw_hands and a folder of backgrounds. The contact sheet shows examples.
    """
    from deltasafe.perception.data.augmented_set import augment_images
    from deltasafe.perception.data.contact_sheet import contact_sheet
    from deltasafe.perception.data.labeled_images import LabeledImageSet

    hands = LabeledImageSet.load(raw_hands)
    backgrounds, _ = store.dataset(config.backgrounds, "backgrounds")
    folder = store.folder("augmented_hands", context.run.run_id[:8])
    settings, progress = config.augmentation.settings(), progress_of(context)
    made = augment_images(hands, folder, settings, backgrounds, workers=config.workers, progress=progress)
    sheet = folder.with_name(f"{folder.name}-sheet.png")
    contact_sheet(hands, made, sheet)
    metadata = {"contact sheet": inline_picture(sheet), "images": made.n, **folder_facts(folder, made.digest[:16])}
    return dg.Output(folder, metadata=metadata, data_version=dg.DataVersion(made.digest[:16]))


@_retried(kinds={"pytorch"}, partitions_def=members, backfill_policy=dg.BackfillPolicy.single_run(), pool=ALL_CORES)
@no_retry
def ensemble_member(
    context: dg.AssetExecutionContext,
    config: MemberConfig,
    augmented_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
    tracker: dg.ResourceParam[Tracker],
    executor: dg.ResourceParam[Executor],
) -> dict[str, pathlib.Path]:
    """One trained network per partition, with its own random initialization and order of images.

    Made from augmented_hands. An interrupted training resumes from its checkpoint.
    """
    from assets.training import Training

    names = members.get_partition_keys()
    seeds = {name: config.first_seed + names.index(name) for name in sorted(context.partition_keys)}
    training = Training(config.training.settings(), config.device, config.workers, store, tracker, executor)
    return training.run(context, seeds, augmented_hands)


@_retried(kinds={"pytorch", "markdown"}, pool=ALL_CORES)
@no_retry
def calibration_report(
    context: dg.AssetExecutionContext,
    config: ReportConfig,
    ensemble_member: dict[str, pathlib.Path],
    raw_hands: pathlib.Path,
    test_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
    tracker: dg.ResourceParam[Tracker],
) -> dg.Output[pathlib.Path]:
    """Report on the ensemble: accuracy, calibration and the smallest supported delta, on all pixels of the test images.

    Made from all members and test_hands. The check may_be_frozen decides on its figures.
    """
    from deltasafe.io.storage import sha256_of_file
    from deltasafe.perception.data.labeled_images import LabeledImageSet
    from deltasafe.perception.evaluate_and_freeze import EvaluationSettings, evaluate_ensemble
    from deltasafe.perception.training.member import Member

    trained = [Member.load(folder) for _, folder in sorted(ensemble_member.items())]
    folder, test = store.folder("calibration_report", context.run.run_id[:8]), LabeledImageSet.load(test_hands)
    delta = planning_delta(context.run.run_config)
    calibration = dataclasses.replace(config.calibration.settings(), planning_delta=delta)
    report = evaluate_ensemble(
        trained,
        test,
        folder,
        EvaluationSettings(config.inference.settings(), calibration),
        _calibration_set(config.calibration_folder, raw_hands),
        device=config.device,
        progress=progress_of(context),
    )
    figures, data = report.figures(), {f"test {test.info.plural}": test.digest}
    page = tracker.report(trained[0].ensemble_identity, figures, folder, data)
    shown = readable(figures, test.info.singular)
    metadata = {**report_with_summary(folder / "report.md"), **shown, **page_link(page)}
    version = dg.DataVersion(sha256_of_file(folder / "report.json")[:16])
    return dg.Output(folder, metadata={**metadata, **folder_facts(folder)}, data_version=version)


def _calibration_set(folder: str, training: pathlib.Path) -> "LabeledImageSet | None":
    from deltasafe.perception.data.labeled_images import LabeledImageSet, check_disjoint

    if not folder:
        return None
    calibration = LabeledImageSet.load(folder)
    check_disjoint(LabeledImageSet.load(training), calibration)
    return calibration


@_retried(kinds={"pytorch", "onnx"}, code_version="2")
@no_retry
def frozen_ensemble(
    ensemble_member: dict[str, pathlib.Path],
    calibration_report: pathlib.Path,
    raw_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
    tracker: dg.ResourceParam[Tracker],
) -> dg.Output[pathlib.Path]:
    """The ensemble as a folder for use in other projects, named by its content, and registered in MLflow as challenger.

    Made from all members and the calibration report, only if the check may_be_frozen passed.
    """
    from deltasafe.perception.data.labeled_images import LabeledImageSet
    from deltasafe.perception.evaluate_and_freeze import freeze_ensemble
    from deltasafe.perception.settings import EVALUATION_PIXELS
    from deltasafe.perception.training.member import Member

    trained = [Member.load(folder) for _, folder in sorted(ensemble_member.items())]
    golden_rgb, _ = LabeledImageSet.load(raw_hands).read(0, EVALUATION_PIXELS)
    folder = freeze_ensemble(trained, calibration_report, golden_rgb, store.home / "frozen")
    page = tracker.register(trained[0].ensemble_identity, folder)
    card = dg.MetadataValue.md((folder / "model_card.md").read_text(encoding="utf-8"))
    metadata = {"model card": card, "members": len(trained), **page_link(page), **folder_facts(folder, folder.name)}
    return dg.Output(folder, metadata=metadata, data_version=dg.DataVersion(folder.name))


@_retried(kinds={"mlflow"}, check_specs=[NOT_WORSE], dagster_type=dg.Any, pool="registry")
@no_retry
def champion(
    context: dg.AssetExecutionContext,
    config: PromotionConfig,
    frozen_ensemble: pathlib.Path,
    test_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
    registry: dg.ResourceParam[Registry],
) -> dg.MaterializeResult:
    """The ensemble in use: the new one, unless it is worse than the previous one on the same test images.

    Made from frozen_ensemble, test_hands and the MLflow registry. The check new_ensemble_is_not_worse gives the reason.
    """
    from deltasafe.perception.artifact.promotion import decide_promotion
    from deltasafe.perception.data.labeled_images import LabeledImageSet

    present, objection = registry.champion(), registry.objection(frozen_ensemble)
    test, scores = LabeledImageSet.load(test_hands), store.home / "scores"
    settings, progress = config.settings(), progress_of(context)
    verdict = decide_promotion(frozen_ensemble, present, test, scores, settings, objection, progress)
    folder = registry.decide(frozen_ensemble, verdict.promoted, verdict.reason)
    return dg.MaterializeResult(
        value=folder,
        metadata={"decision": verdict_table(verdict), **folder_facts(folder, folder.name)},
        data_version=dg.DataVersion(folder.name),
        check_results=[not_worse(verdict)],
    )
