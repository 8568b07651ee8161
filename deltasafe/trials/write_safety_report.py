"""The safety report on disk: judged, drawn, filmed and written as one folder."""

import dataclasses
import pathlib
import shutil
from collections.abc import Sequence

from deltasafe.compute.progress import Progress, silent
from deltasafe.execution.film import save_film
from deltasafe.execution.verdict import SafetyVerdict, judge
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.perception.data.labeled_images import read_rgb
from deltasafe.planning import PlannedMotion
from deltasafe.scene import LoggedScene
from deltasafe.trials.executed_path_figure import executed_over_image
from deltasafe.trials.execution_figure import execution_figure
from deltasafe.trials.executions import load_execution, load_outcomes
from deltasafe.trials.motions import load_motion
from deltasafe.trials.occupancy_fields import load_occupancy_grid, load_p_occupied
from deltasafe.trials.overview import tile_pictures
from deltasafe.trials.safety_report import SafetyReport, SceneReport
from deltasafe.trials.safety_report_text import safety_markdown, safety_summary

__all__ = ["write_safety_report"]


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
        write_json(temporary / "report.json", {"figures": report.figures(), **dataclasses.asdict(report)})
        (temporary / "report.md").write_text(safety_markdown(report), encoding="utf-8")
        (temporary / "summary.md").write_text(safety_summary(report), encoding="utf-8")
        tile_pictures([temporary / f"{scene.id}-plan.png" for scene in scenes], temporary / "plans.jpg")
        driven = [temporary / f"{scene.id}-executed.png" for scene in scenes if reasons[scene.id].executed]
        if driven:
            tile_pictures(driven, temporary / "executed.jpg")
    return report


def _judge_scene(
    scene: LoggedScene, motion: PlannedMotion, fields: pathlib.Path, executions: pathlib.Path, folder: pathlib.Path
) -> SafetyVerdict:
    execution = load_execution(executions, scene.id)
    grid = load_occupancy_grid(fields, scene.id)
    v_min_mps = motion.settings.v_min_mps
    figure = execution_figure(execution, motion.tracking, min_speed_mps=v_min_mps, title=scene.id)
    figure.savefig(folder / f"{scene.id}-execution.png", dpi=110)
    executed_over_image(
        read_rgb(scene.image_path),
        load_p_occupied(fields, scene.id),
        scene.camera,
        motion,
        execution,
        folder / f"{scene.id}-executed.png",
        title=scene.id,
    )
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
