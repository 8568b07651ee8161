"""Retention: what a home keeps, and the deletion of the rest.

Kept are the newest runs and all that is young, what a pointer or a kept run refers to, the ensemble in use, challengers
that may still be promoted, earlier champions, and all that a registered version refers to. Folders of studies are kept:
they resume. Data of users (`incoming/`) and MLflow's records on a server are never touched.
"""

import contextlib
import dataclasses
import functools
import os
import pathlib
import shutil
import sqlite3
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import dagster as dg

from deltasafe.errors import SettingsError
from deltasafe.io.storage import read_json
from pipelines.home import TRACKING_VARIABLE
from pipelines.storage.shared_store import STORE_VARIABLE
from pipelines.tracking.mlflow_records import IDENTITY_TAG, MlflowRecords
from pipelines.tracking.superfluous import delete_run, delete_version, superfluous_runs, superfluous_versions
from pipelines.tracking.tracker import MlflowTracker

_VARIABLES = {"runs": "DELTASAFE_KEEP_RUNS", "days": "DELTASAFE_KEEP_DAYS", "versions": "DELTASAFE_KEEP_VERSIONS"}
_DAY_S = 24 * 3600.0
_FINISHED = [dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED]
_UNFINISHED = [status for status in dg.DagsterRunStatus if status not in _FINISHED]
_STUDIES = ("study_cell", "planner", "safety_trials", "safety_study", "tracking")
"""Starts of the names of assets whose folders are results of studies, also unfinished ones."""
_REMOVED = ".removed"
_DATABASES = ("mlflow/mlflow.db", "dagster/history/runs/index.db", "dagster/history/runs.db")


@dataclasses.dataclass(frozen=True)
class RetentionSettings:
    """How much a home keeps.

    Attributes:
        runs: number of the newest finished runs, and of the newest ensembles in MLflow.
        days: everything that is younger is kept.
        versions: number of the newest registered versions, and of the latest champions.
    """

    runs: int = 20
    days: float = 7.0
    versions: int = 20

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not 0 <= value < 1e6:
                raise SettingsError(f"{name} must be at least 0, got {value}")

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> "RetentionSettings":
        """Read `$DELTASAFE_KEEP_RUNS`, `$DELTASAFE_KEEP_DAYS` and `$DELTASAFE_KEEP_VERSIONS`.

        Raises:
            SettingsError: a variable is no number, or negative.
        """
        default, given = dataclasses.asdict(cls()), {}
        for key, value in default.items():
            name = _VARIABLES[key]
            try:
                given[key] = type(value)(environment.get(name) or value)
            except ValueError:
                kind = "a whole number" if isinstance(value, int) else "a number"
                raise SettingsError(f"{name} must be {kind}, got {environment[name]!r}") from None
        return cls(**given)


@dataclasses.dataclass(frozen=True)
class Deletable:
    """Something that no setting keeps.

    Attributes:
        part: part of the home that it belongs to, e.g. ``store/planned_motions``.
        name: its name there.
        n_bytes: its size.
        delete: deletes it.
    """

    part: str
    name: str
    n_bytes: int
    delete: Callable[[], None]


class Retention:
    """What may be deleted from a home.

    Args:
        root: the home.
        instance: its Dagster instance.
        settings: how much to keep.
        checks: keys of the asset checks, whose latest results are kept; by default those of this project.

    Raises:
        SettingsError: the artifacts are in a shared store, of which one home cannot know what is used.
    """

    def __init__(
        self,
        root: pathlib.Path,
        instance: dg.DagsterInstance,
        settings: RetentionSettings,
        checks: Iterable[dg.AssetCheckKey] | None = None,
    ) -> None:
        if os.environ.get(STORE_VARIABLE):
            raise SettingsError(f"{STORE_VARIABLE} is set: nothing is deleted from a home that shares its artifacts")
        self.root, self.instance, self.settings = root, instance, settings
        self._checks = list(_all_checks() if checks is None else checks)
        self._oldest_s = time.time() - settings.days * _DAY_S

    def survey(self) -> list[Deletable]:
        """Find all that may be deleted, runs first."""
        kept, runs = self._runs()
        versions, registered = self._versions(kept)
        referred = self._referred_folders(kept)
        interrupted = [*self.root.glob(f"store/*/.*{_REMOVED}"), *self.root.glob(f"frozen/.*{_REMOVED}")]
        left = [self._paths(path.parent.relative_to(self.root).as_posix(), path.name, [path]) for path in interrupted]
        return [*runs, *versions, *self._store(referred), *self._frozen(referred, registered), *left]

    def prune(self, deletables: Iterable[Deletable]) -> None:
        """Delete, and give the space of the databases back to the file system."""
        for each in deletables:
            each.delete()
        for name in _DATABASES:
            if (self.root / name).is_file():
                with (
                    contextlib.suppress(sqlite3.OperationalError),  # in use now: the next time
                    contextlib.closing(sqlite3.connect(self.root / name, timeout=1.0)) as connection,
                ):
                    connection.execute("VACUUM")

    def disk_use(self, deletables: Iterable[Deletable]) -> list[dict[str, Any]]:
        """Return a row per part of the home: its size, and how much of it may be deleted."""
        free: dict[str, list[int]] = defaultdict(lambda: [0, 0])
        for each in deletables:
            free[each.part][0] += 1
            free[each.part][1] += each.n_bytes
        parts = [path for path in self.root.iterdir() if path.name != "store"]
        parts += list((self.root / "store").glob("*"))
        sizes = {path.relative_to(self.root).as_posix(): _size(path) for path in parts}
        rows: list[dict[str, Any]] = [
            {"part": part, "MB": round(n_bytes / 1e6, 1), "deletable": free[part][0]}
            | {"deletable MB": round(free[part][1] / 1e6, 1)}
            for part, n_bytes in sorted(sizes.items(), key=lambda item: -item[1])
        ]
        total = {key: round(sum(row[key] for row in rows), 1) for key in ("MB", "deletable", "deletable MB")}
        return [*rows, {"part": "all", **total}]

    def _is_young(self, path: pathlib.Path) -> bool:
        times = [path.lstat().st_mtime, *(each.lstat().st_mtime for each in path.glob("*"))]
        return max(times) >= self._oldest_s

    def _runs(self) -> tuple[set[str], list[Deletable]]:
        """Return the ids of the runs that are kept, and the others."""
        unfinished = self.instance.get_runs(dg.RunsFilter(statuses=_UNFINISHED))
        finished = self.instance.get_run_records(dg.RunsFilter(statuses=_FINISHED))  # newest first
        kept = {run.run_id for run in unfinished} | self._latest_runs()
        for rank, record in enumerate(finished):
            ended_s = record.end_time or record.create_timestamp.timestamp()
            if rank < self.settings.runs or ended_s >= self._oldest_s:
                kept.add(record.dagster_run.run_id)
        known = {record.dagster_run.run_id for record in finished}
        left = {path.name for path in (self.root / "pointers" / "runs").glob("*")} - known  # deleted in the UI
        return kept, [self._run(run_id, run_id in known) for run_id in sorted((known | left) - kept)]

    def _run(self, run_id: str, is_known: bool) -> Deletable:
        dagster = self.root / "dagster"
        folders = [self.root / "pointers" / "runs" / run_id, dagster / "storage" / run_id]
        files = list((dagster / "history" / "runs").glob(f"{run_id}.db*"))

        def delete() -> None:
            if is_known:
                self.instance.delete_run(run_id)
            _remove(*folders, *files)

        return Deletable("dagster", run_id, sum(map(_size, (*folders, *files))), delete)

    def _latest_runs(self) -> set[str]:
        """Return the runs of the latest value of each asset, partition and check."""
        pointers = (self.root / "pointers" / "current").rglob("*.json")
        found = {str(read_json(file).get("run_id")) for file in pointers}
        for record in self.instance.get_asset_records(list(self.instance.all_asset_keys())):
            if record.asset_entry.last_materialization_record is not None:
                found.add(record.asset_entry.last_materialization_record.run_id)
        storage = self.instance.event_log_storage
        latest = storage.get_latest_asset_check_execution_by_key(self._checks) if self._checks else {}
        return found | {record.run_id for record in latest.values()}

    def _referred_folders(self, kept: Collection[str]) -> set[pathlib.Path]:
        files = list((self.root / "pointers" / "current").rglob("*.json"))
        for run_id in kept:
            files += (self.root / "pointers" / "runs" / run_id).rglob("*.json")
        note = self.root / "champion.json"
        noted = [self.root / "frozen" / read_json(note)["artifact"]] if note.is_file() else []
        pointers = [read_json(file) for file in files]
        folders = [self.root / pointer["folder"] for pointer in pointers if "folder" in pointer]
        return {folder.resolve() for folder in (*folders, *noted)}

    def _store(self, referred: Collection[pathlib.Path]) -> list[Deletable]:
        unfinished = self.instance.get_runs(dg.RunsFilter(statuses=_UNFINISHED))
        running = {run.run_id[:8] for run in unfinished}
        is_training = bool(unfinished)
        found = []
        for folder in sorted((self.root / "store").glob("*/[!.]*")):
            asset = folder.parent.name
            if asset.startswith(_STUDIES) or not folder.is_dir() or (asset == "ensemble_member" and is_training):
                continue
            if any(each.is_relative_to(folder.resolve()) for each in referred) or folder.name[-8:] in running:
                continue
            if not self._is_young(folder):
                paths = [folder, *folder.parent.glob(f"{folder.name}-*.*")]  # with its contact sheet
                found.append(self._paths(f"store/{asset}", folder.name, paths))
        return found

    def _frozen(self, referred: Collection[pathlib.Path], registered: Collection[str] | None) -> list[Deletable]:
        if registered is None:
            return []
        folders = [path for path in sorted((self.root / "frozen").glob("[!.]*")) if path.is_dir()]
        free = [path for path in folders if path.name not in registered and path.resolve() not in referred]
        return [self._paths("frozen", path.name, [path]) for path in free if not self._is_young(path)]

    def _paths(self, part: str, name: str, paths: list[pathlib.Path]) -> Deletable:
        return Deletable(part, name, sum(map(_size, paths)), functools.partial(_remove, *paths))

    def _versions(self, kept: Collection[str]) -> tuple[list[Deletable], Collection[str] | None]:
        """Return what may be deleted from MLflow, and the artifacts of the versions that stay; None if unknown."""
        if os.environ.get(TRACKING_VARIABLE) or not (self.root / "mlflow" / "mlflow.db").is_file():
            return [], None
        oldest_ms = int(1000 * self._oldest_s)
        with MlflowTracker(self.root).records() as records:
            records.adopt_decisions()
            free = superfluous_versions(records, self.settings.versions, oldest_ms)
            numbers = {version.version for version in free}
            stay = [version for version in records.versions() if version.version not in numbers]
            needed = {name for v in stay for name in (str(v.run_id), v.tags.get(IDENTITY_TAG, ""))}
            runs = superfluous_runs(records, needed, kept, self.settings.runs, oldest_ms)
        found = [self._recorded(f"version {v.version}", [], functools.partial(delete_version, version=v)) for v in free]
        found += [
            self._recorded(f"run {run}", folders, functools.partial(delete_run, run=run)) for run, folders in runs
        ]
        return found, {str(version.tags.get("artifact", "")) for version in stay}

    def _recorded(self, name: str, folders: list[pathlib.Path], delete: Callable[[MlflowRecords], None]) -> Deletable:
        def apply() -> None:
            with MlflowTracker(self.root).records() as records:
                delete(records)
            artifacts = self.root / "mlflow" / "artifacts"
            _remove(*(folder for folder in folders if folder.is_relative_to(artifacts)))

        return Deletable("mlflow", name, sum(map(_size, folders)), apply)


def _all_checks() -> Iterable[dg.AssetCheckKey]:
    import assets

    found = [*dg.load_assets_from_package_module(assets), *dg.load_asset_checks_from_package_module(assets)]
    return {spec.key for each in found if isinstance(each, dg.AssetsDefinition) for spec in each.check_specs}


def _remove(*paths: pathlib.Path) -> None:
    """Remove files and folders. A folder is hidden first, so that no reader finds a part of it."""
    for path in paths:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path.rename(path.with_name(f".{path.name}{_REMOVED}")))
        else:
            path.unlink(missing_ok=True)


def _size(path: pathlib.Path) -> int:
    with contextlib.suppress(OSError):
        if not path.is_dir() or path.is_symlink():
            return path.lstat().st_size
        return sum(_size(each) for each in path.iterdir())
    return 0
