"""URDF of an arm: the chain from its base to the flange with the arm's limits, and the planner's tool as last link."""

import math
import pathlib
import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from deltasafe.errors import DataError
from deltasafe.execution.arm import JointLimits
from deltasafe.execution.arm_models import ArmModel
from deltasafe.execution.chain_model import rotation_of
from deltasafe.planning.body import ToolBody
from deltasafe.planning.parts import ToolPart

TOOL_LINK = "tool"
LIMITS = ("lower", "upper", "velocity", "effort")
TOOL_DENSITY_KGPM3 = 1200.0  # printed plastic
TOOL_RGBA = (0.05, 0.50, 0.42, 1.0)
LINK_RGBA = (0.82, 0.83, 0.85, 1.0)


def read_chain(path: pathlib.Path, flange_link: str) -> ET.Element:
    """Read the links and joints from the base to ``flange_link``, with absolute paths of meshes.

    Raises:
        DataError: the file cannot be read, has no such link, or names meshes that do not exist; lists all of these.
    """
    try:
        robot = ET.parse(path).getroot()
    except (OSError, ET.ParseError) as error:
        raise DataError(path, f"is not a readable URDF file: {error}") from error
    links = [str(link.get("name")) for link in robot.findall("link")]
    if flange_link not in links:
        raise DataError(path, f"has no link {flange_link!r}; it has {', '.join(sorted(links)) or 'none'}")
    above = {_end(joint, "child"): joint for joint in robot.findall("joint")}
    kept, link = [flange_link], flange_link
    while link in above and len(kept) <= len(links):
        link = _end(above[link], "parent")
        kept.append(link)
    for part in [*robot.findall("link"), *robot.findall("joint")]:
        if (part.get("name") if part.tag == "link" else _end(part, "child")) not in kept:
            robot.remove(part)
    missing = []
    for mesh in robot.iter("mesh"):
        name = str(mesh.get("filename"))
        file = _mesh_file(path, name)
        if file is None:
            missing.append(name)
        mesh.set("filename", str(file))
    if missing:
        raise DataError(path, f"names meshes that do not exist: {', '.join(sorted(set(missing)))}")
    return robot


def limits_of(path: pathlib.Path, robot: ET.Element) -> JointLimits:
    """Read the limits of the revolute joints; where the file has soft limits of positions, the narrower ones.

    Raises:
        DataError: a joint has no limits; lists all of these.
    """
    rows, defects = [], []
    for joint in robot.findall("joint[@type='revolute']"):
        found = [joint.find(tag) for tag in ("limit", "safety_controller")]
        hard, soft = ({} if element is None else element.attrib for element in found)
        try:
            low, high, speed, torque = (float(hard.get(name, "nan")) for name in LIMITS)
            low = max(low, float(soft.get("soft_lower_limit", low)))
            high = min(high, float(soft.get("soft_upper_limit", high)))
        except ValueError:
            low = high = speed = torque = math.nan
        rows.append((low, high, speed, torque))
        if not (low < high and speed > 0 and torque > 0):
            defects.append(str(joint.get("name")))
    if defects or not rows:
        names = ", ".join(defects) or "any joint"
        raise DataError(path, f"has no usable limits (lower < upper, velocity and effort above 0) for {names}")
    return JointLimits(*(tuple(column) for column in zip(*rows, strict=True)))


def add_tool(robot: ET.Element, folder: pathlib.Path, model: ArmModel, limits: JointLimits, body: ToolBody) -> None:
    """Add the tool as the last link of a chain of ``read_chain``, and write the limits into its joints.

    Args:
        folder: gets the meshes of the tool.
    """
    for color in robot.findall(f"material[@name='{model.recolored}']/color"):
        color.set("rgba", " ".join(map(str, LINK_RGBA)))
    for index, joint in enumerate(robot.findall("joint[@type='revolute']")):
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit")
        limit.set("lower", repr(limits.lower_rad[index]))
        limit.set("upper", repr(limits.upper_rad[index]))
        limit.set("effort", repr(limits.torque_nm[index]))
        limit.set("velocity", repr(limits.velocity_radps[index]))
    shapes = (
        _tool_shapes(body, folder)
        if not body.parts
        else "".join(_part_shapes(part, folder / f"part_{number}.obj") for number, part in enumerate(body.solids))
    )
    robot.append(ET.fromstring(f'<link name="{TOOL_LINK}">{_tool_inertia(body)}{shapes}</link>'))
    roll, pitch, yaw = model.flange_rpy_rad
    down = rotation_of(model.flange_rpy_rad) @ np.array([0.0, 0.0, body.shaft_length_m])
    x, y, z = (np.array(model.flange_xyz_m) + down).tolist()
    robot.append(
        ET.fromstring(
            f'<joint name="tool_mount" type="fixed"><parent link="{model.flange_link}"/><child link="{TOOL_LINK}"/>'
            f'<origin xyz="{x!r} {y!r} {z!r}" rpy="{roll + math.pi!r} {pitch!r} {yaw!r}"/></joint>'
        )
    )


def _end(joint: ET.Element, end: str) -> str:
    link = joint.find(end)
    return "" if link is None else str(link.get("link"))


def _mesh_file(urdf: pathlib.Path, name: str) -> pathlib.Path | None:
    """File of a mesh; ``package://`` is looked for in the folder of the URDF file and in those above it."""
    rest = name.removeprefix("package://").removeprefix("file://")
    folders = urdf.parents if name.startswith("package://") else urdf.parents[:1]
    return next((folder / rest for folder in folders if (folder / rest).is_file()), None)


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
