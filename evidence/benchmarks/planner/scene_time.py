"""Time of the four steps from a prediction to a trajectory, for logged scenes."""

import pathlib
import statistics
import time
from typing import Any

import cv2
import numpy as np

from deltasafe.planning import DistanceField, MotionSettings, plan, schedule
from deltasafe.scene import grid_from_image, load_scenes
from pipelines.home import DATASETS

STEPS = ("field from image", "distances", "path", "schedule")


def scene_times(repeats: int, n_scenes: int = 5, scenes: pathlib.Path = DATASETS / "scenes") -> dict[str, Any]:
    """Return medians in ms over scenes and repeats; p_occupied is the true mask, blurred to a network's sharpness."""
    settings = MotionSettings()
    taken: dict[str, list[float]] = {name: [] for name in (*STEPS, "whole")}
    for scene in load_scenes(scenes)[:n_scenes]:
        mask = np.asarray(cv2.imread(str(scene.mask_path), cv2.IMREAD_GRAYSCALE))
        blurred = cv2.GaussianBlur((mask > 0).astype(np.float32), (0, 0), 3.0)
        p_occupied = np.clip(blurred, 0.0, 1.0).astype(np.float32)
        for repeat in range(repeats + 1):
            clock = [time.thread_time()]
            grid = grid_from_image(p_occupied, scene.camera, scene.table_z_m, scene.hand_height_m)
            clock.append(time.thread_time())
            field = DistanceField.build(grid, settings.delta)
            clock.append(time.thread_time())
            result = plan(scene.start, scene.goal, field, settings, repeat)
            clock.append(time.thread_time())
            if result.path is None:
                continue
            schedule(result.path, field, settings)
            clock.append(time.thread_time())
            if repeat > 0:  # the first one warms up
                for name, before, after in zip(STEPS, clock[:-1], clock[1:], strict=True):
                    taken[name].append(after - before)
                taken["whole"].append(clock[-1] - clock[0])
    return {"median_ms": {name: 1e3 * statistics.median(values) for name, values in taken.items()}}
