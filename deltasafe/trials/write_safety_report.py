"""Write the safety report of all executions: evaluation, figures and films, as one folder."""

import dataclasses
import pathlib
import shutil

from deltasafe.compute.progress import Progress, silent
from deltasafe.execution import SafetyVerdict, Workcell, evaluate_execution, save_film
from deltasafe.io.images import read_rgb
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.perception.data.dataset_info import DatasetInfo
from deltasafe.planning import PlannedMotion
from deltasafe.scene import LoggedScene
from deltasafe.trials.executed_path_figure import Caption, executed_over_image
from deltasafe.trials.execution_figure import execution_figure
from deltasafe.trials.executions import load_execution, load_outcomes
from deltasafe.trials.motions import PlannedScenes, load_motion
from deltasafe.trials.occupancy_fields import load_occupancy_grid, load_p_occupied
from deltasafe.trials.overview import tile_pictures
from deltasafe.trials.safety_report import SafetyReport, SceneReport
from deltasafe.trials.safety_report_text import safety_markdown, safety_summary


def write_safety_report(
    planned: PlannedScenes,
    executions: pathlib.Path,
    folder: pathlib.Path,
    *,
    n_films: int = 3,
    progress: Progress = silent,
) -> SafetyReport:
    """Evaluate all executions; write reports (JSON, Markdown), figures and films atomically.

    Args:
        executions: folder that `execute_scenes` wrote.
        n_films: number of filmed executions, those closest to the hand, and after them those without a true hand;
            unsafe ones are filmed in addition.
    """
    outcomes = {outcome.scene_id: outcome for outcome in load_outcomes(executions)}
    scenes, info = planned.scenes, DatasetInfo.load(planned.fields)
    with atomic_folder(folder) as temporary:
        info.save(temporary)
        reports, delta, alpha = [], 0.0, 0.0
        for done, scene in enumerate(scenes, start=1):
            motion, outcome = load_motion(planned.motions, scene.id), outcomes[scene.id]
            delta, alpha = motion.settings.delta, motion.settings.motion_alpha
            verdict = None
            if outcome.executed:
                verdict = _evaluate_scene(scene, motion, planned.fields, executions, temporary)
            shutil.copyfile(planned.motions / scene.id / "plan.png", temporary / f"{scene.id}-plan.png")
            reports.append(_scene_report(scene, motion, verdict, outcome.reason))
            progress(done, len(scenes), f"evaluated {scene.id}")
        filmed = _to_film(reports, n_films)
        for done, scene in enumerate((scene for scene in scenes if scene.id in filmed), start=1):
            film = temporary / f"{scene.id}.gif"
            execution = load_execution(executions, scene.id)
            cell = Workcell(execution.body, scene.mesh_if_known(), scene.table_z_m)
            save_film(film, execution, scene.camera, cell, thing=info.singular)
            progress(done, len(filmed), f"filmed {scene.id}")
        films = {name: f"{name}.gif" for name in filmed}
        reports = [dataclasses.replace(report, film=films.get(report.scene_id, "")) for report in reports]
        report = SafetyReport(delta, tuple(reports), alpha)
        write_json(temporary / "report.json", {"figures": report.figures(), **dataclasses.asdict(report)})
        (temporary / "report.md").write_text(safety_markdown(report, info), encoding="utf-8")
        (temporary / "summary.md").write_text(safety_summary(report, info), encoding="utf-8")
        tile_pictures([temporary / f"{scene.id}-plan.png" for scene in scenes], temporary / "plans.jpg")
        executed = [temporary / f"{scene.id}-executed.png" for scene in scenes if outcomes[scene.id].executed]
        if executed:
            tile_pictures(executed, temporary / "executed.jpg")
    return report


def _evaluate_scene(
    scene: LoggedScene, motion: PlannedMotion, fields: pathlib.Path, executions: pathlib.Path, folder: pathlib.Path
) -> SafetyVerdict:
    execution, thing = load_execution(executions, scene.id), DatasetInfo.load(fields).singular
    figure = execution_figure(execution, motion.settings, scene.id, thing)
    figure.savefig(folder / f"{scene.id}-execution.png", dpi=110)
    executed_over_image(
        read_rgb(scene.image_path),
        load_p_occupied(fields, scene.id),
        scene.camera,
        motion,
        execution,
        folder / f"{scene.id}-executed.png",
        Caption(scene.id, thing),
    )
    grid = load_occupancy_grid(fields, scene.id)
    return evaluate_execution(execution, grid, motion.settings, motion.margin_m)


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
        margin_m=motion.margin_m,
    )


def _to_film(reports: list[SceneReport], n_films: int) -> set[str]:
    """Scenes of the executions closest to the hand, and of all unsafe ones."""
    verdicts = {report.scene_id: report.verdict for report in reports if report.verdict is not None}
    distance_m = {name: verdict.min_tool_to_hand_m for name, verdict in verdicts.items()}
    closest = sorted(distance_m, key=lambda name: (distance_m[name] is None, distance_m[name] or 0.0, name))
    return {*closest[:n_films], *(name for name, verdict in verdicts.items() if verdict.safe is False)}
