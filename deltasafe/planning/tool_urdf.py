"""The tool as a link of a URDF file: its collision shapes become the parts of the body."""

import math
import pathlib
import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError, SettingsError
from deltasafe.planning.body import ToolBody
from deltasafe.planning.parts import ToolPart


def tool_from_urdf(
    path: str | pathlib.Path, link: str, shaft_length_m: float = 0.25, shaft_radius_m: float = 0.005
) -> ToolBody:
    """Read the collision shapes of a link: boxes, cylinders, spheres and capsules (an extension that PyBullet reads).

    Args:
        path: the URDF file.
        link: its frame is the tool's frame: the origin is the point that a pose places, z points up along the shaft.
        shaft_length_m, shaft_radius_m: of the shaft between the tool's origin and the flange; length 0 for none.

    Raises:
        DataError: the file, the link or a shape is unusable; lists all such shapes. Meshes are not read. Boxes and
            cylinders must stand upright; the planner keeps the tool upright.
        SettingsError: the shaft is out of range.
    """
    path = pathlib.Path(path)
    try:
        root = ET.parse(path).getroot()
    except (OSError, ET.ParseError) as error:
        raise DataError(path, f"is not a readable URDF file: {error}") from error
    links = {str(one.get("name")): one for one in root.iter("link")}
    if link not in links:
        raise DataError(path, f"has no link {link!r}; it has {', '.join(sorted(links)) or 'none'}")
    parts, defects = [], []
    for number, collision in enumerate(links[link].findall("collision")):
        try:
            parts.append(_part_of(collision))
        except (SettingsError, TypeError, ValueError) as error:
            defects.append(f"collision {number}: {error}")
    if defects or not parts:
        raise DataError(path, f"link {link!r}: " + ("; ".join(defects) or "has no collision shape"))
    return ToolBody(shaft_length_m=shaft_length_m, shaft_radius_m=shaft_radius_m, parts=tuple(parts))


def _part_of(collision: ET.Element) -> ToolPart:
    shapes = [shape for geometry in collision.findall("geometry") for shape in geometry]
    if len(shapes) != 1:
        raise ValueError(f"needs one shape, has {len(shapes)}")
    shape, origin = shapes[0], collision.find("origin")
    x, y, z = _numbers("0 0 0" if origin is None else origin.get("xyz", "0 0 0"), 3)
    turn = _rotation(*_numbers("0 0 0" if origin is None else origin.get("rpy", "0 0 0"), 3))
    if shape.tag == "sphere":
        return ToolPart("sphere", x, y, z, radius_m=_numbers(shape.get("radius"), 1)[0])
    if shape.tag == "capsule":
        axis = (turn[:, 2] * _numbers(shape.get("length"), 1)[0] / 2).tolist()
        return ToolPart("capsule", x, y, z, axis[0], axis[1], axis[2], _numbers(shape.get("radius"), 1)[0])
    if shape.tag not in ("box", "cylinder"):
        raise ValueError(f"{shape.tag} is not read; use boxes, cylinders, spheres or capsules that contain it")
    if abs(turn[2, 2]) < 1 - 1e-9:
        tilt = math.degrees(math.acos(min(abs(float(turn[2, 2])), 1.0)))
        raise ValueError(f"the {shape.tag} is tilted by {tilt:.1f} degrees, but must stand upright; use a capsule")
    yaw = math.atan2(turn[1, 0], turn[0, 0])
    if shape.tag == "box":
        a, b, c = _numbers(shape.get("size"), 3)
        return ToolPart("box", x, y, z, a / 2, b / 2, c / 2, yaw_rad=yaw)
    radius, length = _numbers(shape.get("radius"), 1)[0], _numbers(shape.get("length"), 1)[0]
    return ToolPart("disc", x, y, z, radius, radius, length / 2)


def _numbers(text: str | None, count: int) -> list[float]:
    values = [float(word) for word in (text or "").split()]
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError(f"expected {count} numbers, got {text!r}")
    return values


def _rotation(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Rotation matrix of URDF's roll, pitch and yaw, about fixed axes x, y and z in this order."""
    (a, b, c), (d, e, f) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    around_x = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
    around_y = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    around_z = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
    return np.asarray(around_z @ around_y @ around_x)
