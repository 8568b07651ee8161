"""Images of the simulated arm from PyBullet's software renderer, which needs neither a window nor a GPU."""

import dataclasses
from typing import Self

import numpy as np
from numpy.typing import NDArray

from deltasafe.execution.arm_models import ArmModel, ArmSettings
from deltasafe.execution.workcell import Workcell
from deltasafe.execution.world import World
from deltasafe.scene.camera import Camera

Array = NDArray[np.float64]

_NEAR_M, _FAR_M = 0.01, 5.0
_LIGHT = (0.6, -1.0, 2.0)
_BACKGROUND_RGB = (222, 228, 236)


@dataclasses.dataclass(frozen=True)
class Viewpoint:
    """A pinhole view.

    Attributes:
        width, height: pixels.
        camera_from_world: (4, 4), OpenGL axes (x right, y up, z backward).
        clip_from_camera: (4, 4), OpenGL's perspective matrix.
    """

    width: int
    height: int
    camera_from_world: Array
    clip_from_camera: Array

    @classmethod
    def of_camera(cls, camera: Camera, width: int, near_m: float = _NEAR_M) -> Self:
        """Return the view of the logged camera, ``width`` pixels wide, with the near plane at ``near_m``."""
        rotation = np.asarray(camera.world_from_camera_rotation, dtype=np.float64)
        axes = rotation @ np.diag([1.0, -1.0, -1.0])
        clip = _perspective(
            2 * camera.fx / camera.width,
            2 * camera.fy / camera.height,
            1 - 2 * camera.cx / camera.width,
            2 * camera.cy / camera.height - 1,
            near_m,
        )
        height = round(width * camera.height / camera.width)
        return cls(width, height, _camera_from_world(axes, np.asarray(camera.position_m)), clip)

    @classmethod
    def looking_at(cls, eye_m: Array, target_m: Array, width: int, height: int, focal: float = 1.6) -> Self:
        """Return an upright view from ``eye_m`` to ``target_m``; ``focal`` is in half image heights."""
        backward = np.asarray(eye_m, dtype=np.float64) - np.asarray(target_m)
        backward /= np.linalg.norm(backward)
        right = np.cross([0.0, 0.0, 1.0], backward)
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(backward, right), backward], axis=1)
        clip = _perspective(focal * height / width, focal, 0, 0)
        return cls(width, height, _camera_from_world(axes, np.asarray(eye_m)), clip)

    def pixels(self, points_m: Array) -> Array:
        """Project points (N, 3) to pixels (N, 2); NaN behind the camera."""
        points = np.column_stack([points_m, np.ones(len(points_m))])
        clip = points @ (self.clip_from_camera @ self.camera_from_world).T
        depth = np.where(clip[:, 3] > _NEAR_M, clip[:, 3], np.nan)
        x, y = clip[:, 0] / depth, clip[:, 1] / depth
        return np.stack([(x + 1) / 2 * self.width, (1 - y) / 2 * self.height], axis=1)


class ArmView:
    """Renders an arm (by default the iiwa 14) in any posture. Use it as a context manager."""

    def __init__(self, cell: Workcell, arm: ArmSettings | None = None) -> None:
        self._world = World(cell, ArmModel.of(arm or ArmSettings()))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._world.close()

    def render(self, joint_positions_rad: Array, viewpoint: Viewpoint) -> NDArray[np.uint8]:
        """Return the image (H, W, 3) uint8 of a posture."""
        return self._image(joint_positions_rad, viewpoint)[0]

    def links_in_view(self, joint_positions_rad: Array, viewpoint: Viewpoint) -> dict[int, int]:
        """Return the number of pixels of each visible link: 0 the base, without the tool."""
        labels = self._image(joint_positions_rad, viewpoint)[1]
        labels = labels[labels >= 0]
        links = labels[(labels & 0xFFFFFF) == self._world.arm] >> 24
        numbers, counts = np.unique(links[links <= self._world.tool_link], return_counts=True)
        return dict(zip(numbers.tolist(), counts.tolist(), strict=True))

    def _image(self, joints: Array, viewpoint: Viewpoint) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
        p = self._world.bullet
        self._world.place(joints)
        _, _, rgba, _, labels = p.getCameraImage(
            viewpoint.width,
            viewpoint.height,
            viewpoint.camera_from_world.T.ravel().tolist(),
            viewpoint.clip_from_camera.T.ravel().tolist(),
            lightDirection=_LIGHT,
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.45,
            lightSpecularCoeff=0.05,
            shadow=1,
            renderer=p.ER_TINY_RENDERER,
            flags=p.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
            physicsClientId=self._world.client,
        )
        shape = (viewpoint.height, viewpoint.width)
        image = np.reshape(np.asarray(rgba, dtype=np.uint8), (*shape, 4))[:, :, :3].copy()
        labels = np.reshape(np.asarray(labels, dtype=np.int32), shape)
        image[labels < 0] = _BACKGROUND_RGB
        return image, labels


def _camera_from_world(axes: Array, eye_m: Array) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = axes.T
    matrix[:3, 3] = -axes.T @ eye_m
    return matrix


def _perspective(x_scale: float, y_scale: float, x_shift: float, y_shift: float, near_m: float = _NEAR_M) -> Array:
    depth = _FAR_M - near_m
    return np.array(
        [
            [x_scale, 0, x_shift, 0],
            [0, y_scale, y_shift, 0],
            [0, 0, -(_FAR_M + near_m) / depth, -2 * _FAR_M * near_m / depth],
            [0, 0, -1, 0],
        ],
        dtype=np.float64,
    )
