"""The paper's studies of perception: augmentation schemes, ensemble size, ablation. Several hours of training."""

import pathlib
from typing import TYPE_CHECKING

import dagster as dg

from assets.config import configurable
from assets.interfaces import Store, Tracker
from assets.policies import ALL_CORES, no_retry
from assets.progress import progress_of
from assets.reporting import Metadata, inline_report, page_link
from deltasafe import presets
from deltasafe.compute.executor import LOCAL, Executor

if TYPE_CHECKING:
    from deltasafe.perception.training.train_member import StepReport
    from deltasafe.studies.perception.study import OnStep, Study

PRESET = presets.active()
GROUP = "perception_study"
OWNERS = ["team:perception"]

# in the order of work
cells = dg.StaticPartitionsDefinition([cell.name for cell in PRESET.study.cells()])

AugmentationConfig = configurable(PRESET.augmentation)
TrainingConfig = configurable(PRESET.training)
InferenceConfig = configurable(PRESET.inference)
CalibrationConfig = configurable(PRESET.calibration)


class CellConfig(dg.Config):
    """Settings of all cells. Number of images, left-out method and epochs are set by the cell."""

    augmentation: AugmentationConfig = AugmentationConfig()
    training: TrainingConfig = TrainingConfig()
    inference: InferenceConfig = InferenceConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    backgrounds: str = ""
    device: str = "auto"
    workers: int = 0


def open_study(
    config: CellConfig, train: pathlib.Path, test: pathlib.Path, store: Store, executor: Executor = LOCAL
) -> "Study":
    """Open the study of the active preset. Assets and command line use this function, so they share their results."""
    from deltasafe.perception.data.labeled_images import LabeledImageSet
    from deltasafe.studies.perception.study import Study

    return Study(
        settings=PRESET.study,
        augmentation=config.augmentation.settings(),
        training=config.training.settings(),
        inference=config.inference.settings(),
        calibration=config.calibration.settings(),
        train=LabeledImageSet.load(train),
        test=LabeledImageSet.load(test),
        backgrounds=store.dataset(config.backgrounds, "backgrounds")[0],
        home=store.home / "store",
        device=config.device,
        workers=config.workers,
        executor=executor,
    )


@dg.asset(
    group_name=GROUP,
    owners=OWNERS,
    kinds={"pytorch"},
    code_version="1",
    partitions_def=cells,
    backfill_policy=dg.BackfillPolicy.single_run(),
    pool=ALL_CORES,
)
@no_retry
def study_cell(
    context: dg.AssetExecutionContext,
    config: CellConfig,
    raw_hands: pathlib.Path,
    test_hands: pathlib.Path,
    store: dg.ResourceParam[Store],
    tracker: dg.ResourceParam[Tracker],
    executor: dg.ResourceParam[Executor],
) -> dict[str, pathlib.Path]:
    """One ensemble per scheme and size, all trained with the same number of gradient steps, and its scores."""
    study, made = open_study(config, raw_hands, test_hands, store, executor), {}
    for cell in study.settings.cells():
        if cell.name in context.partition_keys:
            report = study.evaluate(cell, _steps_of(context), progress_of(context))
            made[cell.name] = folder = study.report_folder(cell)
            page = tracker.report(folder.name, report.figures(), folder, {"test hands": study.test.digest})
            metadata = {**report.figures(), "distinct images": study.augmented_set(cell).n_distinct, **page_link(page)}
            context.add_asset_metadata(metadata, partition_key=cell.name)
    return made


# the tables show the finished cells and name the missing ones
_FINISHED = {"study_cell": dg.AssetIn(metadata={"allow_missing_partitions": True})}


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"markdown"}, code_version="1", ins=_FINISHED)
@no_retry
def augmentation_tables(
    context: dg.AssetExecutionContext, study_cell: dict[str, pathlib.Path], store: dg.ResourceParam[Store]
) -> dg.Output[pathlib.Path]:
    """Tables I and II: our scheme and the four schemes that the paper compares it with, beside the paper's values."""
    return _write_section(context, "schemes", study_cell, store)


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"markdown"}, code_version="1", ins=_FINISHED)
@no_retry
def ensemble_size(
    context: dg.AssetExecutionContext, study_cell: dict[str, pathlib.Path], store: dg.ResourceParam[Store]
) -> dg.Output[pathlib.Path]:
    """Table III and Fig. 4: scores and reliability over the number of members, from one set of stored predictions."""
    return _write_section(context, "ensemble_size", study_cell, store)


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"markdown"}, code_version="1", ins=_FINISHED)
@no_retry
def augmentation_ablation(
    context: dg.AssetExecutionContext, study_cell: dict[str, pathlib.Path], store: dg.ResourceParam[Store]
) -> dg.Output[pathlib.Path]:
    """The effect of each method of our scheme: each is left out once."""
    return _write_section(context, "ablation", study_cell, store)


def _write_section(
    context: dg.AssetExecutionContext, section: str, cell_folders: dict[str, pathlib.Path], store: Store
) -> dg.Output[pathlib.Path]:
    from deltasafe.perception.calibration.report import CalibrationReport
    from deltasafe.studies.perception.report import write_study

    reports = {name: CalibrationReport.load(folder) for name, folder in cell_folders.items()}
    folder = store.folder(context.asset_key.to_user_string(), context.run.run_id[:8])
    report = write_study(folder, PRESET.study, reports, [section])
    metadata: Metadata = {"report": inline_report(report), "finished cells": len(reports), "folder": str(folder)}
    return dg.Output(folder, metadata=metadata)


def _steps_of(context: dg.AssetExecutionContext) -> "OnStep":
    log_progress = progress_of(context, every_s=20.0)

    def on_step(name: str, step: "StepReport") -> None:
        text = f"{name}: step {step.step} of {step.n_steps}, loss {step.loss:.3f}, {step.images_per_s:.1f} images/s"
        log_progress(step.step, step.n_steps + 1, text)

    return on_step
