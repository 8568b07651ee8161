"""The scene as the camera sees it: logged scenes, cameras, and grids of occupancy probabilities."""

from deltasafe.scene.camera import Camera
from deltasafe.scene.extrusion import FieldSettings, grid_from_image
from deltasafe.scene.fusion import fuse_grids
from deltasafe.scene.image_stamp import ImageStamp
from deltasafe.scene.logged_scenes import LoggedScene, load_scenes
from deltasafe.scene.occupancy import OccupancyGrid
from deltasafe.scene.shapes import Cuboid, Shape, Sphere, grid_from_shapes, p_occupied_near

__all__ = [
    "Camera",
    "Cuboid",
    "FieldSettings",
    "ImageStamp",
    "LoggedScene",
    "OccupancyGrid",
    "Shape",
    "Sphere",
    "fuse_grids",
    "grid_from_image",
    "grid_from_shapes",
    "load_scenes",
    "p_occupied_near",
]
