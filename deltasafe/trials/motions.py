"""A delta-safe motion for each logged scene, or the reason why there is none."""

import pathlib
from collections.abc import Sequence

from deltasafe.compute.progress import Progress, silent
from deltasafe.io.storage import atomic_folder
from deltasafe.perception.calibration.delta_support import Calibration, require_supported_delta
from deltasafe.perception.data.labeled_images import read_rgb
from deltasafe.planning import MotionSettings, PlannedMotion, plan_motion
from deltasafe.planning.audit import Audit, verify_motion
from deltasafe.scene import LoggedScene
from deltasafe.trials.motion_figure import plan_over_image
from deltasafe.trials.occupancy_fields import load_occupancy_grid, load_p_occupied, load_seen

__all__ = ["audit_motions", "load_motion", "plan_scenes"]


def plan_scenes(
    scenes: Sequence[LoggedScene],
    fields: str | pathlib.Path,
    folder: str | pathlib.Path,
    settings: MotionSettings,
    calibration: Calibration,
    seed: int,
    progress: Progress = silent,
) -> dict[str, PlannedMotion]:
    """Plan every scene into `SCENE/` with a picture `SCENE/plan.png`; the folder appears as a whole.

    Args:
        fields: folder of `write_fields`.
        calibration: of the ensemble that made the fields.
        seed: of the search; scene k uses seed + k.

    Raises:
        SettingsError: the calibration does not support ``settings.delta``.
    """
    require_supported_delta(settings.delta, calibration)
    motions = {}
    with atomic_folder(folder) as temporary:
        for index, scene in enumerate(scenes):
            grid = load_occupancy_grid(fields, scene.id)
            stamp = load_seen(fields, scene.id)
            motion = plan_motion(grid, scene.start, scene.goal, settings, seed + index, stamp)
            motion.save(temporary / scene.id)
            plan_over_image(
                read_rgb(scene.image_path),
                load_p_occupied(fields, scene.id),
                scene.camera,
                motion,
                motion.body,
                settings.delta,
                temporary / scene.id / "plan.png",
            )
            motions[scene.id] = motion
            outcome = f"{motion.trajectory.duration_s:.1f} s" if motion.trajectory else motion.reason
            progress(index + 1, len(scenes), f"planned {scene.id}: {outcome}")
    return motions


def load_motion(folder: str | pathlib.Path, scene_id: str) -> PlannedMotion:
    """The planned motion of a scene.

    Raises:
        DataError: there is none in ``folder``.
    """
    return PlannedMotion.load(pathlib.Path(folder) / scene_id)


def audit_motions(
    scenes: Sequence[LoggedScene], fields: str | pathlib.Path, motions: str | pathlib.Path
) -> dict[str, Audit]:
    """Audit the motion of each scene that has a trajectory."""
    audits = {}
    for scene in scenes:
        motion = load_motion(motions, scene.id)
        if motion.trajectory is not None:
            audits[scene.id] = verify_motion(motion, load_occupancy_grid(fields, scene.id))
    return audits
