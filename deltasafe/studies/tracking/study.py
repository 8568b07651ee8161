"""The tracking study: resumable runs, then slope, constant and coverage on disjoint sets of runs."""

import dataclasses
import pathlib

import numpy as np

from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError
from deltasafe.io.arrays import read_npz
from deltasafe.io.records import from_json
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.studies.resumable_jobs import Effort, run_batches
from deltasafe.studies.tracking.bound import Coverage, coverage_of, fit_bound, fit_constant
from deltasafe.studies.tracking.settings import TrackingStudySettings
from deltasafe.studies.tracking.tracking_errors import Tracks, record_runs

FORMAT = 1
PAPER_MIN_SPEED_MPS = 0.01
"""The paper's line is evaluated at no lower speed, because it is 0 at rest."""


@dataclasses.dataclass(frozen=True)
class TrackingStudy:
    """All runs: first those for the slope, then those for the constant, then held-out ones.

    Attributes:
        settings: of the study.
        tracks: samples of ``settings.n_runs`` runs.
        effort: time spent.
    """

    settings: TrackingStudySettings
    tracks: Tracks
    effort: Effort

    @property
    def slope_runs(self) -> Tracks:
        """Runs that determine the slope."""
        return self.tracks.part(0, self.settings.n_slope_runs)

    @property
    def bound_runs(self) -> Tracks:
        """Runs that determine the constant."""
        first = self.settings.n_slope_runs
        return self.tracks.part(first, first + self.settings.n_bound_runs)

    @property
    def held_out(self) -> Tracks:
        """Runs on which the bound is tested."""
        return self.tracks.part(self.tracks.n_runs - self.settings.n_held_out_runs, self.tracks.n_runs)

    @property
    def bound(self) -> TrackingBound:
        """The identified bound."""
        return fit_bound(self.slope_runs, self.bound_runs, self.settings.content)

    @property
    def paper_slope_bound(self) -> TrackingBound:
        """The paper's slope with a constant that makes it a tolerance bound."""
        paper = TrackingBound()
        return TrackingBound(fit_constant(self.bound_runs, paper.gamma1_s), paper.gamma1_s)

    def coverage(self) -> tuple[Coverage, ...]:
        """Compute the coverage of the identified bound on the held-out runs: all samples, then bins."""
        return coverage_of(self.bound, self.held_out)

    def figures(self) -> dict[str, float]:
        """Collect the figures of a record, by name; lengths in meters, slopes in seconds."""
        whole = self.coverage()[0]
        paper_slope = coverage_of(self.paper_slope_bound, self.held_out)[0]
        paper = coverage_of(TrackingBound(), self.held_out, PAPER_MIN_SPEED_MPS)[0]
        simulated_s = float(self.tracks.simulated_s.sum())
        return {
            "tracking_gamma0_m": self.bound.gamma0_m,
            "tracking_gamma1_s": self.bound.gamma1_s,
            "tracking_runs": self.settings.n_bound_runs,
            "tracking_held_out_runs": whole.runs,
            "tracking_coverage": whole.run_fraction,
            "tracking_coverage_lower95": whole.runs_lower95,
            "tracking_coverage_samples": whole.sample_fraction,
            "tracking_paper_slope_gamma0_m": self.paper_slope_bound.gamma0_m,
            "tracking_paper_slope_coverage": paper_slope.run_fraction,
            "tracking_paper_slope_coverage_lower95": paper_slope.runs_lower95,
            "tracking_paper_line_coverage": paper.run_fraction,
            "tracking_paper_line_coverage_samples": paper.sample_fraction,
            "tracking_largest_error_m": whole.largest_error_m,
            "tracking_cpu_minutes": self.effort.cpu_minutes,
            "tracking_realtime_factor": simulated_s / (60 * self.effort.cpu_minutes),
        }

    def save(self, folder: str | pathlib.Path) -> None:
        """Write study.json, bound.json and tracks.npz atomically."""
        with atomic_folder(folder) as temporary:
            np.savez_compressed(temporary / "tracks.npz", **dataclasses.asdict(self.tracks))
            write_json(
                temporary / "study.json",
                {"format": FORMAT, "settings": self.settings, "effort": self.effort, "figures": self.figures()},
            )
            write_json(temporary / "bound.json", self.bound)

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "TrackingStudy":
        """Read a folder that ``save`` wrote.

        Raises:
            DataError: a file is missing, damaged, or of another format.
        """
        folder = pathlib.Path(folder)
        record = read_json(folder / "study.json")
        if not isinstance(record, dict) or record.get("format") != FORMAT:
            raise DataError(folder / "study.json", f"is not a tracking study of format {FORMAT}; run it again")
        arrays = read_npz(folder / "tracks.npz")
        try:
            settings, tracks = from_json(TrackingStudySettings, record["settings"]), Tracks(**arrays)
            if tracks.n_runs != settings.n_runs:
                raise ValueError(f"it has {tracks.n_runs} runs, the settings require {settings.n_runs}")
            return cls(settings, tracks, Effort(**record["effort"]))
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(folder, f"is not a tracking study of this version ({error}); run it again") from error


def run_study(
    settings: TrackingStudySettings,
    folder: str | pathlib.Path,
    workers: int = 1,
    progress: Progress = silent,
    executor: Executor = LOCAL,
) -> TrackingStudy:
    """Run or resume the study; each batch in ``folder`` is ``settings.runs_per_batch`` runs.

    Args:
        workers: number of processes; it does not change the results.

    Raises:
        PlanningError: the box of the study is out of the arm's reach.
        DataError: a batch is damaged.
    """
    size, total = settings.runs_per_batch, settings.n_runs
    of_run = dataclasses.replace(settings, n_slope_runs=1, n_bound_runs=settings.min_bound_runs, n_held_out_runs=1)
    jobs = [(f"runs-{first:05d}", (of_run, first, min(first + size, total))) for first in range(0, total, size)]
    batches, effort = run_batches(record_runs, jobs, folder, workers, progress, executor=executor)
    names = [field.name for field in dataclasses.fields(Tracks)]
    return TrackingStudy(
        settings, Tracks.joined([Tracks(**{name: batch[name] for name in names}) for batch in batches]), effort
    )
