"""The safety report: what happened in every scene, as a table, as figures, as pictures and films."""

import dataclasses
import pathlib
import shutil
from collections.abc import Sequence
from typing import Any

from deltasafe.execution.film import save_film
from deltasafe.execution.safety import SafetyVerdict, judge
from deltasafe.figures.execution import execution_figure
from deltasafe.planning import PlannedMotion
from deltasafe.progress import Progress, silent
from deltasafe.scene import LoggedScene
from deltasafe.storage import atomic_folder, read_json, write_json
from deltasafe.trials.executions import load_execution, load_outcomes
from deltasafe.trials.fields import load_field
from deltasafe.trials.motions import load_motion
from deltasafe.trials.overview import tile_pictures
from deltasafe.trials.safety_markdown import safety_markdown, safety_summary

__all__ = ["SafetyReport", "SceneReport", "write_safety_report"]


@dataclasses.dataclass(frozen=True)
class SceneReport:
    """What became of one scene.

    Attributes:
        outcome: `executed`, or why not.
        verdict: None unless it was executed.
        cost, length_m, duration_s: of the planned motion; None without one. ``cost_squared_m2`` and ``area_m2`` are
            the same path under the paper's two cost functions.
        film: name of the film beside the report, empty if there is none.
    """

    scene_id: str
    outcome: str
    verdict: SafetyVerdict | None
    cost: float | None
    cost_squared_m2: float | None
    area_m2: float | None
    length_m: float | None
    duration_s: float | None
    film: str = ""


@dataclasses.dataclass(frozen=True)
class SafetyReport:
    """All scenes, and the settings that they were judged with."""

    delta: float
    scenes: tuple[SceneReport, ...]

    @property
    def verdicts(self) -> list[SafetyVerdict]:
        """Of the scenes that were executed."""
        return [scene.verdict for scene in self.scenes if scene.verdict is not None]

    def figures(self) -> dict[str, float]:
        """The figures of all executions together, by short name; lengths in metres."""
        verdicts = self.verdicts
        found: dict[str, float] = {
            "scenes": len(self.scenes),
            "scenes_executed": len(verdicts),
            "scenes_safe": sum(verdict.safe for verdict in verdicts),
            "contacts": sum(verdict.contacts for verdict in verdicts),
        }
        if verdicts:
            poses = sum(verdict.poses for verdict in verdicts)
            safe = sum(verdict.delta_safe_share * verdict.poses for verdict in verdicts)
            tool = [v.min_tool_to_hand_m for v in verdicts if v.min_tool_to_hand_m is not None]
            arm = [v.min_arm_to_hand_m for v in verdicts if v.min_arm_to_hand_m is not None]
            found |= {
                "delta_safe_pose_share": safe / poses,
                "motions_wholly_delta_safe": sum(verdict.whole_motion_delta_safe for verdict in verdicts),
                "max_tracking_error_m": max(verdict.max_error_m for verdict in verdicts),
                "max_tracking_excess_m": max(verdict.max_excess_m for verdict in verdicts),
                **({"min_tool_to_hand_m": min(tool)} if tool else {}),
                **({"min_arm_to_hand_m": min(arm)} if arm else {}),
            }
        return found


def write_safety_report(
    scenes: Sequence[LoggedScene],
    fields: pathlib.Path,
    motions: pathlib.Path,
    executions: pathlib.Path,
    folder: pathlib.Path,
    *,
    n_films: int = 3,
    progress: Progress = silent,
) -> SafetyReport:
    """Judge all executions and write reports (JSON, Markdown), pictures and films; whole or not at all.

    Args:
        fields, motions, executions: folders of `write_fields`, `plan_scenes` and `execute_scenes`.
        n_films: executions to film, those that came closest to the hand; every one that was not safe is added.
    """
    reasons = {outcome.scene_id: outcome for outcome in load_outcomes(executions)}
    with atomic_folder(folder) as temporary:
        reports, delta = [], 0.0
        for done, scene in enumerate(scenes, start=1):
            motion = load_motion(motions, scene.id)
            delta = motion.settings.delta
            verdict = None
            if reasons[scene.id].executed:
                verdict = _judge_scene(scene, motion, fields, executions, temporary)
            shutil.copyfile(motions / scene.id / "plan.png", temporary / f"{scene.id}-plan.png")
            reports.append(_scene_report(scene, motion, verdict, reasons[scene.id].reason))
            progress(done, len(scenes), f"judged {scene.id}")
        filmed = _to_film(reports, n_films)
        for done, name in enumerate(filmed, start=1):
            scene = next(scene for scene in scenes if scene.id == name)
            save_film(
                temporary / f"{name}.gif",
                load_execution(executions, name),
                scene.camera,
                scene.true_mesh(),
                table_z_m=scene.table_z_m,
            )
            progress(done, len(filmed), f"filmed {name}")
        reports = [
            dataclasses.replace(report, film=f"{report.scene_id}.gif" if report.scene_id in filmed else "")
            for report in reports
        ]
        report = SafetyReport(delta, tuple(reports))
        write_json(temporary / "report.json", {"figures": report.figures(), **_plain(report)})
        (temporary / "report.md").write_text(safety_markdown(report), encoding="utf-8")
        (temporary / "summary.md").write_text(safety_summary(report), encoding="utf-8")
        tile_pictures([temporary / f"{scene.id}-plan.png" for scene in scenes], temporary / "plans.jpg")
    return report


def read_figures(folder: str | pathlib.Path) -> dict[str, float]:
    """The figures of a report that was written to ``folder``.

    Raises:
        DataError: there is none.
    """
    return dict(read_json(pathlib.Path(folder) / "report.json")["figures"])


def _judge_scene(
    scene: LoggedScene, motion: PlannedMotion, fields: pathlib.Path, executions: pathlib.Path, folder: pathlib.Path
) -> SafetyVerdict:
    execution = load_execution(executions, scene.id)
    grid = load_field(fields, scene.id)
    v_min_mps = motion.settings.v_min_mps
    figure = execution_figure(execution, motion.tracking, min_speed_mps=v_min_mps, title=scene.id)
    figure.savefig(folder / f"{scene.id}-execution.png", dpi=110)
    return judge(
        execution,
        grid,
        motion.body,
        motion.settings.delta,
        motion.tracking,
        min_speed_mps=v_min_mps,
    )


def _scene_report(scene: LoggedScene, motion: PlannedMotion, verdict: SafetyVerdict | None, reason: str) -> SceneReport:
    path, result = motion.result.path, motion.result
    return SceneReport(
        scene.id,
        "executed" if verdict is not None else reason,
        verdict,
        result.cost,
        result.cost_squared_m2,
        result.area_m2,
        None if path is None else path.length_m,
        None if motion.trajectory is None else motion.trajectory.duration_s,
    )


def _to_film(reports: list[SceneReport], n_films: int) -> list[str]:
    executed = [report for report in reports if report.verdict is not None]
    closest = sorted(executed, key=lambda report: (report.verdict.min_tool_to_hand_m or 0.0, report.scene_id))  # type: ignore[union-attr]
    chosen = {report.scene_id for report in closest[:n_films]}
    chosen |= {report.scene_id for report in executed if not report.verdict.safe}  # type: ignore[union-attr]
    return sorted(chosen)


def _plain(report: SafetyReport) -> dict[str, Any]:
    return dataclasses.asdict(report)
