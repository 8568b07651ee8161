"""The tracking study: identification of the tracking bound gamma(v) on the simulated arm."""

import pathlib

import dagster as dg

from assets.config import configurable
from assets.interfaces import Store
from assets.policies import ALL_CORES, no_retry
from assets.progress import progress_of
from assets.reporting import Metadata, folder_facts, inline_picture
from deltasafe import presets
from deltasafe.compute.executor import Executor

PRESET = presets.active()
GROUP = "tracking_study"
OWNERS = ["team:motion"]

StudyConfig = configurable(PRESET.tracking_study)


class TrackingConfig(dg.Config):
    """Run k has the seed `first_seed` + k. The number of `workers` does not change the results."""

    study: StudyConfig = StudyConfig()
    workers: int = 2


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"bullet", "numba"}, code_version="1", pool=ALL_CORES)
@no_retry
def tracking_bound(
    context: dg.AssetExecutionContext,
    config: TrackingConfig,
    store: dg.ResourceParam[Store],
    executor: dg.ResourceParam[Executor],
) -> dg.Output[pathlib.Path]:
    """The tracking bound gamma(v): a tolerance bound of the tracking error of test motions, tested on held-out runs."""
    from deltasafe.studies.tracking import run_study, write_report

    batches = store.folder("tracking_bound", "batches")
    study = run_study(config.study.settings(), batches, config.workers, progress_of(context), executor)
    folder = store.folder("tracking_bound", context.run_id[:8])
    study.save(folder)
    report = folder.with_name(f"{folder.name}-report")
    figures = write_report(study, report)
    metadata: Metadata = {
        "report": dg.MetadataValue.md((report / "report.md").read_text(encoding="utf-8")),
        "error over speed": inline_picture(report / "tracking.png"),
        **figures,
        **folder_facts(folder),
    }
    return dg.Output(folder, metadata=metadata)


@dg.asset_check(
    asset="tracking_bound", description="The fraction of held-out runs within the bound is at least `content`."
)
def bound_covers_held_out_runs(tracking_bound: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.studies.tracking import TrackingStudy

    study = TrackingStudy.load(tracking_bound)
    coverage = {one.name: one.run_fraction for one in study.coverage()}
    return dg.AssetCheckResult(passed=coverage["all"] >= study.settings.content, metadata=coverage)
