"""Tools from URDF links: shapes, frames and refusals."""

import math
import pathlib

import numpy as np
import pytest

from deltasafe.errors import DataError
from deltasafe.planning import ToolPart, tool_from_urdf


def write(folder: pathlib.Path, *collisions: str) -> pathlib.Path:
    path = folder / "tool.urdf"
    shapes = "".join(f"<collision>{one}</collision>" for one in collisions)
    path.write_text(f'<robot name="r"><link name="base"/><link name="gripper">{shapes}</link></robot>')
    return path


def test_shapes_become_parts_in_the_frame_of_the_link(tmp_path: pathlib.Path) -> None:
    path = write(
        tmp_path,
        '<origin xyz="0.01 0 0.05" rpy="0 0 0.3"/><geometry><box size="0.08 0.02 0.04"/></geometry>',
        '<origin rpy="3.141592653589793 0 0"/><geometry><cylinder radius="0.02" length="0.1"/></geometry>',
        '<geometry><sphere radius="0.01"/></geometry>',
        '<origin rpy="0 1.5707963267948966 0"/><geometry><capsule radius="0.005" length="0.06"/></geometry>',
    )
    body = tool_from_urdf(path, "gripper", shaft_length_m=0.1)
    box, cylinder, sphere, capsule = body.parts
    assert box == ToolPart("box", 0.01, 0.0, 0.05, 0.04, 0.01, 0.02, yaw_rad=box.yaw_rad)
    assert box.yaw_rad == pytest.approx(0.3)
    assert cylinder == ToolPart("disc", 0, 0, 0, 0.02, 0.02, 0.05)
    assert sphere == ToolPart("sphere", radius_m=0.01)
    assert (capsule.half_x_m, capsule.radius_m) == (pytest.approx(0.03), 0.005)
    assert abs(capsule.half_z_m) < 1e-12
    assert len(body.solids) == 5
    assert body.rho_max_m == pytest.approx(np.hypot(0.01 + 0.04 * math.cos(0.3) + 0.01 * math.sin(0.3), 0.0), abs=0.01)


def test_unusable_shapes_are_listed_together(tmp_path: pathlib.Path) -> None:
    path = write(
        tmp_path,
        '<origin rpy="0.2 0 0"/><geometry><box size="1 1 1"/></geometry>',
        '<geometry><mesh filename="a.stl"/></geometry>',
        '<geometry><sphere radius="nan"/></geometry>',
        '<geometry><box size="0.1 0.1"/></geometry>',
        '<geometry><cylinder radius="-0.1" length="0.1"/></geometry>',
        "<geometry/>",
        '<geometry><sphere radius="5"/></geometry>',
    )
    with pytest.raises(DataError) as caught:
        tool_from_urdf(path, "gripper")
    assert "tilted by 11.5 degrees" in str(caught.value)
    assert all(f"collision {number}" in str(caught.value) for number in range(7))


def test_missing_file_link_or_shape_is_named(tmp_path: pathlib.Path) -> None:
    with pytest.raises(DataError, match=r"none\.urdf"):
        tool_from_urdf(tmp_path / "none.urdf", "gripper")
    with pytest.raises(DataError, match="base, gripper"):
        tool_from_urdf(write(tmp_path), "hand")
    with pytest.raises(DataError, match="no collision shape"):
        tool_from_urdf(write(tmp_path), "gripper")
    (tmp_path / "tool.urdf").write_text("<robot>")
    with pytest.raises(DataError, match="readable"):
        tool_from_urdf(tmp_path / "tool.urdf", "gripper")
