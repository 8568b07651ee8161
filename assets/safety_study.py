"""The safety study: thousands of executed motions, and their rates of violations and contacts."""

import pathlib

import dagster as dg

from assets.config import configurable
from assets.interfaces import Registry, Store
from assets.policies import ALL_CORES, no_retry
from assets.progress import progress_of
from assets.reporting import Metadata, folder_facts, inline_picture
from deltasafe import presets
from deltasafe.compute.executor import Executor
from deltasafe.errors import SettingsError

PRESET = presets.active()
GROUP = "safety_study"
OWNERS = ["team:motion"]

StudyConfig = configurable(PRESET.safety_study)


class TrialsConfig(dg.Config):
    """`scenes` are folders of scene folders; empty selects the packaged ones. `n_scenes` are used of each (0: all).

    `ensemble` is the folder of a frozen ensemble; empty selects the one in use.
    """

    study: StudyConfig = StudyConfig()
    scenes: list[str] = []  # noqa: RUF012 - pydantic copies it
    n_scenes: int = PRESET.n_scenes
    ensemble: str = ""
    workers: int = 2


@dg.asset(
    group_name=GROUP,
    owners=OWNERS,
    kinds={"bullet", "numba", "pytorch"},
    code_version="1",
    deps=["champion"],
    pool=ALL_CORES,
)
@no_retry
def safety_trials(
    context: dg.AssetExecutionContext,
    config: TrialsConfig,
    store: dg.ResourceParam[Store],
    registry: dg.ResourceParam[Registry],
    executor: dg.ResourceParam[Executor],
) -> dg.Output[pathlib.Path]:
    """Motions planned and executed by our method and the compared methods, at every delta."""
    from deltasafe.studies.safety import StudyInputs, run_study

    folders = config.scenes or [str(store.dataset("", "scenes")[0])]
    ensemble = config.ensemble or registry.champion()
    if not ensemble:
        raise SettingsError(
            "there is no ensemble in use yet; run `make demo`, or set `ensemble` to the folder of a frozen ensemble"
        )
    inputs = StudyInputs.gather(folders, ensemble, config.n_scenes)
    batches = store.folder("safety_trials", "batches")
    found = run_study(config.study.settings(), inputs, batches, config.workers, progress_of(context), executor)
    folder = store.folder("safety_trials", context.run.run_id[:8])
    found.save(folder)
    counts = {"executed": int(found.executed.sum()), "trials": len(found.executed), "minutes": found.effort.minutes}
    return dg.Output(folder, metadata={**counts, **folder_facts(folder)})


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"markdown"}, code_version="1")
@no_retry
def safety_study_report(
    context: dg.AssetExecutionContext, safety_trials: pathlib.Path, store: dg.ResourceParam[Store]
) -> dg.Output[pathlib.Path]:
    """Report: rates of violations with exact intervals, clearances, comparisons; failures are listed and filmed."""
    from deltasafe.studies.safety import SafetyStudy, write_report

    folder = store.folder("safety_study_report", context.run.run_id[:8])
    figures = write_report(SafetyStudy.load(safety_trials), folder, progress_of(context, every_s=2.0))
    films = [inline_picture(film, 30_000) for film in sorted(folder.glob("*.gif"))[:1]]
    metadata: Metadata = {
        "report": dg.MetadataValue.md((folder / "report.md").read_text(encoding="utf-8")),
        **{name: inline_picture(folder / f"{name}.png", 25_000) for name in ("rates", "clearances", "speed")},
        **({"first failure": films[0]} if films else {}),
        **figures,
        **folder_facts(folder),
    }
    return dg.Output(folder, metadata=metadata)
