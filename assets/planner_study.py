"""The planner study: Fig. 5 (path cost) and Fig. 6 (search time), our planner against the compared methods."""

import pathlib

import dagster as dg

from assets.config import configurable
from assets.interfaces import Store
from assets.policies import ALL_CORES, no_retry
from assets.progress import progress_of
from assets.reporting import Metadata, inline_picture
from deltasafe import presets
from deltasafe.compute.executor import Executor

PRESET = presets.active()
GROUP = "planner_study"
OWNERS = ["team:motion"]
FIGURES = ("fig5", "fig5_references", "fig6", "space")

ComparisonConfig = configurable(PRESET.comparison)
TimingConfig = configurable(PRESET.timing)


class CostConfig(dg.Config):
    """Run k of every method and level has the seed `first_seed` + k."""

    study: ComparisonConfig = ComparisonConfig()
    workers: int = 2


class TimeConfig(dg.Config):
    """The study measures CPU time; more `workers` than idle cores distort it."""

    study: TimingConfig = TimingConfig()
    workers: int = 2


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"numba"}, code_version="1", pool=ALL_CORES)
@no_retry
def planner_costs(
    context: dg.AssetExecutionContext,
    config: CostConfig,
    store: dg.ResourceParam[Store],
    executor: dg.ResourceParam[Executor],
) -> dg.Output[pathlib.Path]:
    """Fig. 5: cost of planned paths over the uncertainty, for four methods and references; every path is verified."""
    from deltasafe.studies.planner import run_comparison

    batches = store.folder("planner_costs", "batches")
    found = run_comparison(config.study.settings(), batches, config.workers, progress_of(context), executor)
    folder = store.folder("planner_costs", context.run_id[:8])
    found.save(folder)
    return dg.Output(folder, metadata={"minutes": found.effort.minutes, "CPU minutes": found.effort.cpu_minutes})


# after the costs, because parallel work would distort the measured times
@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"numba"}, code_version="1", deps=[planner_costs], pool=ALL_CORES)
@no_retry
def planner_times(
    context: dg.AssetExecutionContext,
    config: TimeConfig,
    store: dg.ResourceParam[Store],
    executor: dg.ResourceParam[Executor],
) -> dg.Output[pathlib.Path]:
    """Fig. 6: time of a search over the number of obstacles, for all methods, without and with building the field."""
    from deltasafe.studies.planner import run_timing

    batches = store.folder("planner_times", "batches")
    found = run_timing(config.study.settings(), batches, config.workers, progress_of(context), executor)
    folder = store.folder("planner_times", context.run_id[:8])
    found.save(folder)
    return dg.Output(folder, metadata={"minutes": found.effort.minutes, "CPU minutes": found.effort.cpu_minutes})


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"markdown"}, code_version="1")
@no_retry
def planner_report(
    context: dg.AssetExecutionContext,
    planner_costs: pathlib.Path,
    planner_times: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """Report: which statements of the paper hold here, with its curves for comparison."""
    from deltasafe.studies.planner import Comparison, Timing, write_report

    folder = store.folder("planner_report", context.run_id[:8])
    figures = write_report(Comparison.load(planner_costs), Timing.load(planner_times), folder)
    metadata: Metadata = {
        "report": dg.MetadataValue.md((folder / "report.md").read_text(encoding="utf-8")),
        **{name: inline_picture(folder / f"{name}.png", 22_000) for name in FIGURES},
        **figures,
        "folder": str(folder),
    }
    return dg.Output(folder, metadata=metadata)
