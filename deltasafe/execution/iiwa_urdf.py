"""URDF of the iiwa 14: PyBullet's model with the real arm's limits, and the planner's tool as an eighth link."""

import math
import pathlib
import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from deltasafe.execution.kinematics import IIWA14_LIMITS
from deltasafe.planning.body import ToolBody
from deltasafe.planning.parts import ToolPart

FLANGE_IN_LINK_7_M = 0.045
TOOL_DENSITY_KGPM3 = 1200.0  # printed plastic
TOOL_RGBA = (0.05, 0.50, 0.42, 1.0)
LINK_RGBA = (0.82, 0.83, 0.85, 1.0)


def iiwa_with_tool(folder: pathlib.Path, kuka: pathlib.Path, body: ToolBody) -> ET.Element:
    """Return the URDF of arm and tool with absolute paths of meshes.

    Args:
        folder: gets the mesh of the disc.
        kuka: PyBullet's folder of the arm's model.
    """
    robot = ET.parse(kuka / "model.urdf").getroot()
    for mesh in robot.iter("mesh"):
        mesh.set("filename", str(kuka / str(mesh.get("filename"))))
    for color in robot.findall("material[@name='Blue']/color"):
        color.set("rgba", " ".join(map(str, LINK_RGBA)))
    for index, joint in enumerate(robot.findall("joint")):
        limit = joint.find("limit")
        assert limit is not None
        reach = IIWA14_LIMITS.position_rad[index]
        limit.set("lower", repr(-reach))
        limit.set("upper", repr(reach))
        limit.set("effort", repr(IIWA14_LIMITS.torque_nm[index]))
        limit.set("velocity", repr(IIWA14_LIMITS.velocity_radps[index]))
    shapes = (
        _tool_shapes(body, folder)
        if not body.parts
        else "".join(_part_shapes(part, folder / f"part_{number}.obj") for number, part in enumerate(body.solids))
    )
    robot.append(ET.fromstring(f'<link name="tool">{_tool_inertia(body)}{shapes}</link>'))
    robot.append(
        ET.fromstring(
            '<joint name="tool_mount" type="fixed"><parent link="lbr_iiwa_link_7"/><child link="tool"/>'
            f'<origin xyz="0 0 {FLANGE_IN_LINK_7_M + body.shaft_length_m!r}" rpy="{math.pi!r} 0 0"/></joint>'
        )
    )
    return robot


def _tool_inertia(body: ToolBody) -> str:
    """Disc and shaft of one density, shaft from the upper face of the disc; parts as points of a grid."""
    if body.parts:
        return _inertia_of_points(body)
    half = body.thickness_m / 2
    shaft_m = body.shaft_length_m - half
    shaft_kg = TOOL_DENSITY_KGPM3 * math.pi * body.shaft_radius_m**2 * shaft_m
    disc_kg = TOOL_DENSITY_KGPM3 * math.pi * body.semi_axis_x_m * body.semi_axis_y_m * body.thickness_m
    mass = shaft_kg + disc_kg
    height = shaft_kg * (half + shaft_m / 2) / mass
    across = (
        shaft_kg * (shaft_m**2 / 12 + (half + shaft_m / 2 - height) ** 2)
        + disc_kg * height**2
        + disc_kg * body.rho_max_m**2 / 4
    )
    about = (shaft_kg * body.shaft_radius_m**2) / 2 + disc_kg * (body.semi_axis_x_m**2 + body.semi_axis_y_m**2) / 4
    return (
        f'<inertial><origin xyz="0 0 {height!r}"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{across!r}" iyy="{across!r}" izz="{about!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def _inertia_of_points(body: ToolBody) -> str:
    """Mass and inertia of the union of the parts, from points 1/30 of its extent apart."""
    reach_m = max(part.reach_m for part in body.solids)
    axis = np.linspace(-reach_m, reach_m, 61)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    points = np.concatenate([points[body.distance_m(points) <= 0], [part.center_m for part in body.solids]])
    mass = max(TOOL_DENSITY_KGPM3 * float(axis[1] - axis[0]) ** 3 * len(points), 0.01)
    center = points.mean(axis=0)
    x, y, z = (points - center).T
    around = [mass * float(np.mean(a * a + b * b)) + 1e-7 for a, b in ((y, z), (x, z), (x, y))]
    mixed = [-mass * float(np.mean(a * b)) for a, b in ((x, y), (x, z), (y, z))]
    names = dict(zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), around + mixed, strict=True))
    values = " ".join(f'{name}="{value!r}"' for name, value in names.items())
    origin = " ".join(repr(float(value)) for value in center)
    return f'<inertial><origin xyz="{origin}"/><mass value="{mass!r}"/><inertia {values}/></inertial>'


def _part_shapes(part: ToolPart, mesh: pathlib.Path) -> str:
    """Visual and collision shape of a part: a convex mesh of its core, grown by the radius."""
    mesh.write_text(_convex_mesh(part.surface_points()), encoding="utf-8")
    paint = f'<material name="Tool"><color rgba="{" ".join(map(str, TOOL_RGBA))}"/></material>'
    geometry = f'<geometry><mesh filename="{mesh}"/></geometry>'
    return f"<visual>{geometry}{paint}</visual><collision>{geometry}</collision>"


def _convex_mesh(points: NDArray[np.float64]) -> str:
    """OBJ text of the convex hull of points (n, 3), with outward triangles."""
    hull = ConvexHull(points)
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in points]
    for triangle, outward in zip(hull.simplices, hull.equations[:, :3], strict=True):
        a, b, c = points[triangle]
        order = triangle if np.cross(b - a, c - a) @ outward > 0 else triangle[::-1]
        lines.append("f " + " ".join(str(index + 1) for index in order))
    return "\n".join(lines) + "\n"


def _tool_shapes(body: ToolBody, folder: pathlib.Path) -> str:
    disc = folder / "disc.obj"
    disc.write_text(_elliptic_cylinder(body), encoding="utf-8")
    half = body.thickness_m / 2
    shaft_m = body.shaft_length_m - half
    paint = f'<material name="Tool"><color rgba="{" ".join(map(str, TOOL_RGBA))}"/></material>'
    shapes = ""
    for kind, material in (("visual", paint), ("collision", "")):
        shapes += (
            f'<{kind}><geometry><mesh filename="{disc}"/></geometry>{material}</{kind}>'
            f'<{kind}><origin xyz="0 0 {half + shaft_m / 2!r}"/><geometry>'
            f'<cylinder radius="{body.shaft_radius_m!r}" length="{shaft_m!r}"/></geometry>{material}</{kind}>'
        )
    return shapes


def _elliptic_cylinder(body: ToolBody, corners: int = 64) -> str:
    """OBJ text of the disc: a convex prism inscribed in the elliptic cylinder."""
    angles = 2 * np.pi * np.arange(corners) / corners
    rim = np.stack([body.semi_axis_x_m * np.cos(angles), body.semi_axis_y_m * np.sin(angles)], axis=1)
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for z in (-body.thickness_m / 2, body.thickness_m / 2) for x, y in rim]
    for i in range(1, corners + 1):
        j = i % corners + 1
        lines += [f"f {i} {j} {j + corners}", f"f {i} {j + corners} {i + corners}"]
    for i in range(2, corners):
        lines += [f"f 1 {i + 1} {i}", f"f {corners + 1} {corners + i} {corners + i + 1}"]
    return "\n".join(lines) + "\n"
