"""Forward kinematics: rigid motions, preserved lengths, and angles measured back from the posed bones."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from generator.arm import ArmModel
from generator.person import Body, shaped_points_m
from generator.pose import POSES, Pose, draw_pose
from generator.skeleton import FINGERS, PARENTS, Skeleton, forward_kinematics, local_rotations, relative_to
from generator.skinning import dual_quaternion_skinning, linear_blend_skinning, posed_vertices_m

ARM = ArmModel.load()
SKELETON = Skeleton.of(ARM, shaped_points_m(ARM, Body()))
ANGLES = st.floats(-3, 3)


def posed_directions(pose):
    motion = forward_kinematics(SKELETON, local_rotations(SKELETON, pose))
    return {bone: motion[bone][0] @ SKELETON.directions[bone] for bone in PARENTS}


def test_the_frame_of_the_hand():
    middle, thumb = SKELETON.joints_m["finger-3-1"], SKELETON.joints_m["finger-1-4"]
    assert SKELETON.joints_m["hand"] == pytest.approx([0, 0, 0], abs=1e-12)
    assert middle[1:] == pytest.approx([0, 0], abs=1e-12)
    assert 0.07 < middle[0] < 0.12
    assert thumb[1] < -0.03
    assert SKELETON.joints_m["elbow"][0] < -0.2


def test_the_skeleton_does_not_depend_on_where_the_points_lie():
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    moved = Skeleton.of(ARM, shaped_points_m(ARM, Body()) @ turn.T + [1.0, 2.0, 3.0])
    assert np.allclose(moved.vertices_m, SKELETON.vertices_m, atol=1e-9)
    for bone, axis in SKELETON.flexion_axes.items():
        assert np.allclose(moved.flexion_axes[bone], axis, atol=1e-9), bone


@settings(deadline=None)
@given(st.tuples(ANGLES, ANGLES, ANGLES), st.integers(0, 1000))
def test_turning_the_root_turns_everything_and_nothing_seen_from_the_wrist(vector, seed):
    local = local_rotations(SKELETON, draw_pose(np.random.default_rng(seed), list(POSES)))
    root = Rotation.from_rotvec(vector).as_matrix()
    still, turned = forward_kinematics(SKELETON, local), forward_kinematics(SKELETON, local, root)
    for bone, (m, t) in still.items():
        assert np.allclose(turned[bone][0], root @ m)
        assert np.allclose(turned[bone][1], root @ t)
    one, other = relative_to(still, "wrist"), relative_to(turned, "wrist")
    assert np.allclose(one["wrist"][0], np.eye(3))
    assert np.allclose(one["wrist"][1], 0)
    for bone in PARENTS:
        assert np.allclose(one[bone][0], other[bone][0])
        assert np.allclose(one[bone][1], other[bone][1])


def test_bones_stay_together_and_keep_their_lengths():
    local = local_rotations(SKELETON, POSES["fist"])
    motion = forward_kinematics(SKELETON, local)
    for bone, parent in PARENTS.items():
        if parent is None:
            continue
        head = SKELETON.heads_m[bone]
        by_child, by_parent = (motion[name][0] @ head + motion[name][1] for name in (bone, parent))
        assert by_child == pytest.approx(by_parent, abs=1e-12), f"{bone} is torn off {parent}"
        assert np.allclose(motion[bone][0] @ motion[bone][0].T, np.eye(3))


@pytest.mark.parametrize("flexion_deg", [0, 25, 60, 100])
def test_a_joint_bends_by_the_angle_that_was_asked_for(flexion_deg):
    straight = (0.0, 0.0, 0.0)
    bent = (0.0, float(np.radians(flexion_deg)), 0.0)
    along = posed_directions(Pose(fingers=(straight, bent, straight, straight)))
    first, second = along["finger3-1"], along["finger3-2"]
    measured = np.degrees(np.arccos(np.clip(first @ second, -1, 1)))
    assert measured == pytest.approx(flexion_deg, abs=6)  # the bones of the model lie not quite in one plane
    if flexion_deg:
        assert second[2] < first[2], "flexion bends towards the palm"


def test_fingers_spread_and_the_wrist_extends_the_way_their_names_say():
    straight = ((0.0, 0.0, 0.0),) * 4
    closed, spread = (posed_directions(Pose(straight, spread=s)) for s in ((0, 0, 0, 0), (-0.2, 0, 0.1, 0.3)))
    assert spread["finger2-1"][1] < closed["finger2-1"][1]
    assert spread["finger5-1"][1] > closed["finger5-1"][1]
    forearm = ARM.weights[:, ARM.bone("lowerarm01")] > 0.9
    low, high = (
        posed_vertices_m(ARM, SKELETON, Pose(straight, wrist_extension=a))[forearm, 2].mean() for a in (0.0, 0.3)
    )
    assert high > low + 0.02


@settings(deadline=None, max_examples=20)
@given(st.tuples(ANGLES, ANGLES, ANGLES), st.tuples(ANGLES, ANGLES, ANGLES))
def test_bones_that_move_as_one_move_the_skin_rigidly(vector, offset):
    turn = Rotation.from_rotvec(vector).as_matrix()
    turns, offsets = np.tile(turn, (len(ARM.bones), 1, 1)), np.tile(offset, (len(ARM.bones), 1))
    expected = SKELETON.vertices_m @ turn.T + offset
    assert np.allclose(linear_blend_skinning(SKELETON.vertices_m, ARM.weights, turns, offsets), expected)
    assert np.allclose(dual_quaternion_skinning(SKELETON.vertices_m, ARM.weights, turns, offsets), expected)


def test_skin_of_a_single_bone_follows_that_bone():
    rng = np.random.default_rng(0)
    turns, offsets = Rotation.random(4, random_state=1).as_matrix(), rng.normal(size=(4, 3))
    points, owner = rng.normal(size=(50, 3)), rng.integers(4, size=50)
    weights = np.eye(4)[owner]
    expected = np.einsum("vij,vj->vi", turns[owner], points) + offsets[owner]
    assert np.allclose(linear_blend_skinning(points, weights, turns, offsets), expected)
    assert np.allclose(dual_quaternion_skinning(points, weights, turns, offsets), expected)


def test_dual_quaternions_keep_the_volume_that_linear_blending_loses():
    point, weights = np.array([[1.0, 0, 0]]), np.array([[0.5, 0.5]])
    turns = np.stack([np.eye(3), Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()])
    linear = linear_blend_skinning(point, weights, turns, np.zeros((2, 3)))
    dual = dual_quaternion_skinning(point, weights, turns, np.zeros((2, 3)))
    assert np.linalg.norm(dual) == pytest.approx(1)
    assert np.linalg.norm(linear) == pytest.approx(np.cos(np.pi / 4))
    assert dual[0] == pytest.approx([np.cos(np.pi / 4), np.sin(np.pi / 4), 0])


@pytest.mark.parametrize("name", sorted(POSES))
def test_no_pose_tears_the_skin(name):
    pose = dataclasses.replace(POSES[name], wrist_extension=0.2, forearm_twist=0.1)
    edges = np.concatenate([ARM.quads[:, [0, 1]], ARM.quads[:, [1, 2]]])

    def lengths(vertices):
        return np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)

    stretch = lengths(posed_vertices_m(ARM, SKELETON, pose)) / lengths(SKELETON.vertices_m)
    assert np.percentile(stretch, 99) < 3
    assert np.percentile(stretch, 1) > 0.15


def test_curled_fingers_are_curled():
    tips = {
        name: posed_vertices_m(ARM, SKELETON, POSES[name])[ARM.weights[:, ARM.bone("finger3-3")] > 0.5, 0].max()
        for name in ("flat", "fist")
    }
    assert tips["flat"] > tips["fist"] + 0.05
    assert set(FINGERS) == {2, 3, 4, 5}
