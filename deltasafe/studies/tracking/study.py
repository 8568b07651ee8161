"""The study from runs to bound: resumable batches, then slope, constant and coverage on disjoint sets of them."""

import dataclasses
import pathlib
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError
from deltasafe.io.records import from_json
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.studies.resumable_jobs import Effort, run_batches
from deltasafe.studies.tracking.bound import Coverage, coverage_of, fitted_bound, gamma0_over
from deltasafe.studies.tracking.settings import TrackingStudySettings
from deltasafe.studies.tracking.tracking_errors import Tracks, record_runs

__all__ = ["TrackingStudy", "run_study"]

_FORMAT = 1


@dataclasses.dataclass(frozen=True)
class TrackingStudy:
    """All runs, in the order slope, constant, held out.

    Attributes:
        settings: of the study.
        tracks: of ``settings.n_runs`` runs.
        effort: what they took.
    """

    settings: TrackingStudySettings
    tracks: Tracks
    effort: Effort

    @property
    def slope_runs(self) -> Tracks:
        return self.tracks.part(0, self.settings.n_slope_runs)

    @property
    def bound_runs(self) -> Tracks:
        first = self.settings.n_slope_runs
        return self.tracks.part(first, first + self.settings.n_bound_runs)

    @property
    def held_out(self) -> Tracks:
        return self.tracks.part(self.tracks.n_runs - self.settings.n_held_out_runs, self.tracks.n_runs)

    @property
    def bound(self) -> TrackingBound:
        """The identified bound."""
        return fitted_bound(self.slope_runs, self.bound_runs, self.settings.content)

    @property
    def lifted_paper_line(self) -> TrackingBound:
        """The paper's slope with the constant that makes a tolerance bound of it."""
        paper = TrackingBound()
        return TrackingBound(gamma0_over(self.bound_runs, paper.gamma1_s), paper.gamma1_s)

    def coverage(self) -> tuple[Coverage, ...]:
        """Of the identified bound on the held-out runs; all samples first, then by bins."""
        return coverage_of(self.bound, self.held_out)

    def figures(self) -> dict[str, float]:
        """The figures by name; lengths in meters, slopes in seconds."""
        whole = self.coverage()[0]
        lifted = coverage_of(self.lifted_paper_line, self.held_out)[0]
        paper = coverage_of(TrackingBound(), self.held_out, least_speed_mps=0.01)[0]
        simulated_s = float(self.tracks.simulated_s.sum())
        return {
            "tracking_gamma0_m": self.bound.gamma0_m,
            "tracking_gamma1_s": self.bound.gamma1_s,
            "tracking_runs": self.settings.n_bound_runs,
            "tracking_held_out_runs": whole.runs,
            "tracking_coverage": whole.of_runs,
            "tracking_coverage_lower95": whole.runs_lower95,
            "tracking_coverage_samples": whole.of_samples,
            "tracking_paper_slope_gamma0_m": self.lifted_paper_line.gamma0_m,
            "tracking_paper_slope_coverage": lifted.of_runs,
            "tracking_paper_slope_coverage_lower95": lifted.runs_lower95,
            "tracking_paper_line_coverage": paper.of_runs,
            "tracking_paper_line_coverage_samples": paper.of_samples,
            "tracking_largest_error_m": whole.largest_error_m,
            "tracking_cpu_minutes": self.effort.cpu_minutes,
            "tracking_realtime_factor": simulated_s / (60 * self.effort.cpu_minutes),
        }

    def save(self, folder: str | pathlib.Path) -> None:
        """Write study.json, bound.json and tracks.npz as a whole."""
        with atomic_folder(folder) as temporary:
            np.savez_compressed(temporary / "tracks.npz", **_arrays(self.tracks))  # type: ignore[arg-type]
            write_json(
                temporary / "study.json",
                {"format": _FORMAT, "settings": self.settings, "effort": self.effort, "figures": self.figures()},
            )
            write_json(temporary / "bound.json", self.bound)

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "TrackingStudy":
        """Read what ``save`` wrote.

        Raises:
            DataError: a file is missing, damaged, or of another format.
        """
        folder = pathlib.Path(folder)
        record = read_json(folder / "study.json")
        if not isinstance(record, dict) or record.get("format") != _FORMAT:
            raise DataError(folder / "study.json", f"is not a tracking study of format {_FORMAT}; run it again")
        path = folder / "tracks.npz"
        try:
            settings = from_json(TrackingStudySettings, record["settings"])
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
                tracks = Tracks(**{field.name: arrays[field.name] for field in dataclasses.fields(Tracks)})
            effort = Effort(**record["effort"])
        except (KeyError, TypeError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise DataError(path, f"holds no tracks of this study ({error}); run it again") from error
        if tracks.n_runs != settings.n_runs:
            raise DataError(path, f"holds {tracks.n_runs} runs, its settings ask for {settings.n_runs}; run it again")
        return cls(settings, tracks, effort)


def run_study(
    settings: TrackingStudySettings,
    folder: str | pathlib.Path,
    workers: int = 1,
    progress: Progress = silent,
    executor: Executor = LOCAL,
) -> TrackingStudy:
    """Do all runs in batches below ``folder``; finished ones are found again.

    Args:
        workers: processes; their number changes nothing.

    Raises:
        PlanningError: the box of the study is out of the arm's reach.
        DataError: a batch is damaged.
    """
    size, total = settings.runs_per_batch, settings.n_runs
    of_a_run = dataclasses.replace(settings, n_slope_runs=1, n_bound_runs=settings.least_bound_runs, n_held_out_runs=1)
    jobs = [(f"runs-{first:05d}", (of_a_run, first, min(first + size, total))) for first in range(0, total, size)]
    batches, effort = run_batches(record_runs, jobs, folder, workers, progress, executor=executor)
    names = [field.name for field in dataclasses.fields(Tracks)]
    return TrackingStudy(
        settings, Tracks.joined([Tracks(**{name: batch[name] for name in names}) for batch in batches]), effort
    )


def _arrays(tracks: Tracks) -> dict[str, NDArray[Any]]:
    return {field.name: getattr(tracks, field.name) for field in dataclasses.fields(tracks)}
