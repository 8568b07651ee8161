"""A delta-safe motion for each logged scene, or the reason why there is none."""

import dataclasses
import pathlib
from collections.abc import Sequence

from deltasafe.compute.progress import Progress, silent
from deltasafe.io.images import read_rgb
from deltasafe.io.storage import atomic_folder
from deltasafe.perception.calibration.delta_support import Calibration, require_supported_delta
from deltasafe.planning import MotionSettings, PlannedMotion, plan_motion
from deltasafe.planning.audit import Audit, verify_motion
from deltasafe.scene import LoggedScene
from deltasafe.trials.motion_figure import plan_over_image
from deltasafe.trials.motion_margin import motion_margin_m, require_supported_alpha
from deltasafe.trials.occupancy_fields import load_image_stamp, load_occupancy_grid, load_p_occupied


@dataclasses.dataclass(frozen=True)
class PlannedScenes:
    """Logged scenes with the folders of their occupancy fields and motions.

    Attributes:
        scenes: in order.
        fields: folder that `write_fields` wrote.
        motions: folder that `plan_scenes` wrote.
    """

    scenes: Sequence[LoggedScene]
    fields: pathlib.Path
    motions: pathlib.Path


def plan_scenes(
    scenes: Sequence[LoggedScene],
    fields: pathlib.Path,
    folder: pathlib.Path,
    settings: MotionSettings,
    calibration: Calibration,
    seed: int,
    progress: Progress = silent,
) -> dict[str, PlannedMotion]:
    """Plan every scene; write `SCENE/` with an image `SCENE/plan.png` into ``folder``, which appears atomically.

    Args:
        fields: folder that `write_fields` wrote.
        calibration: of the ensemble that predicted the fields.
        seed: of the search; scene k uses seed + k.

    Raises:
        SettingsError: the calibration does not support ``settings.delta`` or ``settings.motion_alpha``.
    """
    require_supported_delta(settings.delta, calibration)
    require_supported_alpha(settings.delta, settings.motion_alpha, calibration)
    motions = {}
    with atomic_folder(folder) as temporary:
        for index, scene in enumerate(scenes):
            grid = load_occupancy_grid(fields, scene.id)
            stamp = load_image_stamp(fields, scene.id)
            margin_m = motion_margin_m(calibration, settings, scene.camera, grid)
            motion = plan_motion(grid, scene.start, scene.goal, settings, seed + index, stamp, margin_m)
            motion.save(temporary / scene.id)
            plan_over_image(
                read_rgb(scene.image_path),
                load_p_occupied(fields, scene.id),
                scene.camera,
                motion,
                temporary / scene.id / "plan.png",
                scene.table_z_m,
            )
            motions[scene.id] = motion
            outcome = f"{motion.trajectory.duration_s:.1f} s" if motion.trajectory else motion.reason
            progress(index + 1, len(scenes), f"planned {scene.id}: {outcome}")
    return motions


def load_motion(folder: pathlib.Path, scene_id: str) -> PlannedMotion:
    """Load the planned motion of a scene.

    Raises:
        DataError: there is none in ``folder``.
    """
    return PlannedMotion.load(folder / scene_id)


def audit_motions(scenes: Sequence[LoggedScene], fields: pathlib.Path, motions: pathlib.Path) -> dict[str, Audit]:
    """Audit the motion of each scene that has a trajectory."""
    audits = {}
    for scene in scenes:
        motion = load_motion(motions, scene.id)
        if motion.trajectory is not None:
            audits[scene.id] = verify_motion(motion, load_occupancy_grid(fields, scene.id))
    return audits
