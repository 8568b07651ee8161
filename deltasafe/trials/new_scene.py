"""A scene folder from one photograph: image, camera, table, height of the hand, start and goal."""

import dataclasses
import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import cv2
import numpy as np

from deltasafe.cameras.calibration_files import ImageKind, read_camera
from deltasafe.cameras.model import CameraModel
from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.execution.arm import ArmMount
from deltasafe.execution.iiwa_kinematics import IiwaKinematics
from deltasafe.io.images import read_image
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.perception.data.masks import read_mask
from deltasafe.planning import ToolBody
from deltasafe.scene import Camera, FieldSettings, LoggedScene
from deltasafe.scene.logged_scenes import check_scene
from deltasafe.trials.motion_figure import body_outlines
from deltasafe.trials.scene_picture import draw_scene

SCENE, IMAGE, MASK, PICTURE = "scene.json", "image.png", "hand_mask.png", "understood.png"
MAX_PIXELS = 4_000_000
"""A larger photograph is scaled down; the networks see far smaller ones, and voxels cover several pixels."""

ToolPose = tuple[float, float, float, float]


@dataclasses.dataclass(frozen=True)
class SceneDraft:
    """What a scene is made of: lengths in meters, angles in radians, in the world frame (z up).

    Attributes:
        image: photograph as the camera takes it, with its distortion.
        camera: camera file with a pose, as `deltasafe camera locate` writes it, or the scene.json of another scene.
        hand_height_m: height above the table of the highest visible point of the hand.
        start, goal: x, y, z and yaw of the tool.
        table_z_m: height of the table.
        mask: true mask of the hand in the photograph, for evaluation only; None if it is not known.
        image_kind: which image a ROS calibration is for, as in `read_camera`.
    """

    image: pathlib.Path
    camera: pathlib.Path
    hand_height_m: float
    start: ToolPose
    goal: ToolPose
    table_z_m: float = 0.0
    mask: pathlib.Path | None = None
    image_kind: ImageKind | None = None


def write_scene(draft: SceneDraft, folder: str | pathlib.Path) -> LoggedScene:
    """Write a scene folder with the undistorted image and a picture of what was understood, atomically; load it.

    A folder that holds nothing but an earlier scene of this function is replaced.

    Raises:
        DataError: lists all that is wrong: files that cannot be read, sizes that differ, fields outside their domain;
            or ``folder`` holds other files.
    """
    folder, defects = pathlib.Path(folder), list[DataError]()

    def attempt(path: pathlib.Path, read: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return read(*arguments)
        except (DataError, SettingsError) as error:
            defects.append(error if isinstance(error, DataError) else DataError(path, str(error)))
            return None

    attempt(folder, _require_no_other_files, folder)
    photo = attempt(draft.image, read_image, draft.image, MAX_PIXELS)
    model = attempt(draft.camera, _camera_model, draft.camera, draft.image_kind)
    if photo is not None and model is not None:
        model = attempt(draft.image, model.resized, photo.rgb.shape[1], photo.rgb.shape[0])
    mask = None if draft.mask is None else attempt(draft.mask, read_mask, draft.mask)
    if draft.mask is not None and mask is not None and photo is not None and mask.shape[::-1] != photo.size:
        size = f"{mask.shape[1]} x {mask.shape[0]} pixels, the image {photo.size[0]} x {photo.size[1]}"
        defects.append(DataError(draft.mask, f"has {size}; give the mask of that image"))
    record = _record(draft, folder.resolve().name, attempt(draft.camera, model.pinhole) if model else None)
    # the files that it names do not exist yet, and a camera without a model is reported above
    found = [error for error in check_scene(folder / SCENE, record)[1] if error.path == folder / SCENE]
    defects += [one for one in found if "camera" in record or not one.reason.startswith("field camera is missing")]
    if defects:
        raise DataError.combined(folder, defects)
    with atomic_folder(folder) as temporary:
        undistorted = model.undistorted(photo.rgb)
        _write_png(temporary / IMAGE, undistorted[..., ::-1])
        if mask is not None:
            mask = cv2.resize(mask, photo.rgb.shape[1::-1], interpolation=cv2.INTER_NEAREST)
            _write_png(temporary / MASK, model.undistorted(mask, is_mask=True))
        write_json(temporary / SCENE, record)
        scene = LoggedScene.load(temporary)
        draw_scene(undistorted, scene, temporary / PICTURE, scene_warnings(scene))
    return LoggedScene.load(folder)


def scene_warnings(scene: LoggedScene, body: ToolBody | None = None) -> list[str]:
    """Say why no motion will be found or executed, as far as that can be known without a prediction."""
    body, camera, found = body or ToolBody(), scene.camera, []
    top_m = scene.table_z_m + scene.hand_height_m + FieldSettings.depth_margin_m
    arm = IiwaKinematics(ArmMount().on_table(scene.table_z_m), body.shaft_length_m)
    for name, pose in (("start", scene.start), ("goal", scene.goal)):
        uv, _ = camera.project(body_outlines(pose.as_array()[None], body)[0])
        inside = (uv > 0) & (uv < (camera.width, camera.height))  # false for NaN
        if not inside.all() and pose.z_m - body.thickness_m / 2 < top_m:
            found.append(
                f"the tool at the {name} is not wholly inside the camera's view; below z = {top_m:.3f} m, space that "
                "the camera does not see counts as occupied, so no motion will be found"
            )
        try:
            arm.inverse(pose.as_array()[None])
        except PlanningError:
            base = ", ".join(f"{value:g}" for value in arm.mount.base_m)
            found.append(f"the simulated arm, whose base is at ({base}), does not reach the {name}")
    return found


def _require_no_other_files(folder: pathlib.Path) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise DataError(folder, "is a file; give the name of a new folder")
    others = sorted({path.name for path in folder.iterdir()} - {SCENE, IMAGE, MASK, PICTURE})
    if others:
        raise DataError(folder, f"holds other files ({', '.join(others[:3])}); give the name of a new folder")


def _camera_model(path: pathlib.Path, image_kind: ImageKind | None) -> CameraModel:
    record = read_json(path) if path.name == SCENE else None
    if record is None:
        return read_camera(path, image_kind)
    try:
        camera = Camera.from_json(record["camera"] if isinstance(record, Mapping) else {})
    except (KeyError, SettingsError) as error:
        raise DataError(path, f"has no usable camera ({error}); give a camera file") from error
    return CameraModel(**{field.name: getattr(camera, field.name) for field in dataclasses.fields(camera)})


def _record(draft: SceneDraft, name: str, camera: Camera | None) -> dict[str, Any]:
    """Content of scene.json; without a camera if none could be read."""
    ends = {
        end: {"position_m": list(values[:3]), "yaw_rad": values[3]}
        for end, values in (("start", draft.start), ("goal", draft.goal))
    }
    return {
        "id": name,
        "image": IMAGE,
        **({} if camera is None else {"camera": dataclasses.asdict(camera)}),
        "table_z_m": draft.table_z_m,
        "hand_height_m": draft.hand_height_m,
        **ends,
        **({} if draft.mask is None else {"ground_truth": {"mask": MASK}}),
    }


def _write_png(path: pathlib.Path, pixels: Any) -> None:
    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(pixels))[1].tobytes())
