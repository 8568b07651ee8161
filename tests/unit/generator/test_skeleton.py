"""Forward kinematics and skinning: rigid motions, connected bones, angles measured on the posed bones."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from generator.arm import ArmModel
from generator.person import Body, shaped_points_m
from generator.pose import POSES, Pose, sample_pose
from generator.skeleton import PARENTS, Skeleton, forward_kinematics, local_rotations, relative_to
from generator.skinning import dual_quaternion_skinning, linear_blend_skinning, posed_vertices_m

ARM = ArmModel.load()
SKELETON = Skeleton.from_points(ARM, shaped_points_m(ARM, Body()))
ANGLES = st.floats(-3, 3)


def posed_directions(pose):
    motions = forward_kinematics(SKELETON, local_rotations(SKELETON, pose))
    return {bone: motions[bone][0] @ SKELETON.directions[bone] for bone in PARENTS}


def test_hand_frame_has_wrist_at_origin_and_middle_knuckle_on_x():
    middle, thumb = SKELETON.joints_m["finger-3-1"], SKELETON.joints_m["finger-1-4"]
    assert SKELETON.joints_m["hand"] == pytest.approx([0, 0, 0], abs=1e-12)
    assert middle[1:] == pytest.approx([0, 0], abs=1e-12)
    assert 0.07 < middle[0] < 0.12
    assert thumb[1] < -0.03
    assert SKELETON.joints_m["elbow"][0] < -0.2


def test_skeleton_does_not_depend_on_frame_of_points():
    rotation = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    moved = Skeleton.from_points(ARM, shaped_points_m(ARM, Body()) @ rotation.T + [1.0, 2.0, 3.0])
    assert np.allclose(moved.vertices_m, SKELETON.vertices_m, atol=1e-9)
    for bone, axis in SKELETON.flexion_axes.items():
        assert np.allclose(moved.flexion_axes[bone], axis, atol=1e-9), bone


@settings(deadline=None)
@given(st.tuples(ANGLES, ANGLES, ANGLES), st.integers(0, 1000))
def test_motion_relative_to_wrist_ignores_motion_of_whole_arm(vector, seed):
    local = local_rotations(SKELETON, sample_pose(np.random.default_rng(seed), list(POSES)))
    root = Rotation.from_rotvec(vector).as_matrix()
    motions = forward_kinematics(SKELETON, local)
    moved = {bone: (root @ rotation, root @ translation + vector) for bone, (rotation, translation) in motions.items()}
    one, other = relative_to(motions, "wrist"), relative_to(moved, "wrist")
    assert np.allclose(one["wrist"][0], np.eye(3))
    assert np.allclose(one["wrist"][1], 0)
    for bone in PARENTS:
        assert np.allclose(one[bone][0], other[bone][0])
        assert np.allclose(one[bone][1], other[bone][1])


def test_posed_bones_stay_connected_and_rigid():
    motions = forward_kinematics(SKELETON, local_rotations(SKELETON, POSES["fist"]))
    for bone, parent in PARENTS.items():
        if parent is None:
            continue
        head = SKELETON.heads_m[bone]
        by_child, by_parent = (motions[name][0] @ head + motions[name][1] for name in (bone, parent))
        assert by_child == pytest.approx(by_parent, abs=1e-12), f"{bone} is disconnected from {parent}"
        assert np.allclose(motions[bone][0] @ motions[bone][0].T, np.eye(3))


@pytest.mark.parametrize("flexion_deg", [0, 25, 60, 100])
def test_joint_flexes_by_requested_angle(flexion_deg):
    straight = (0.0, 0.0, 0.0)
    bent = (0.0, float(np.radians(flexion_deg)), 0.0)
    along = posed_directions(Pose(fingers=(straight, bent, straight, straight)))
    first, second = along["finger3-1"], along["finger3-2"]
    measured = np.degrees(np.arccos(np.clip(first @ second, -1, 1)))
    assert measured == pytest.approx(flexion_deg, abs=6)  # the bones of the model are not exactly coplanar
    if flexion_deg:
        assert second[2] < first[2], "flexion bends towards the palm"


def test_spread_and_wrist_extension_have_documented_signs():
    straight = ((0.0, 0.0, 0.0),) * 4
    closed, spread = (posed_directions(Pose(straight, spread=s)) for s in ((0, 0, 0, 0), (-0.2, 0, 0.1, 0.3)))
    assert spread["finger2-1"][1] < closed["finger2-1"][1]
    assert spread["finger5-1"][1] > closed["finger5-1"][1]
    forearm = ARM.weights[:, ARM.bone_index("lowerarm01")] > 0.9
    low, high = (
        posed_vertices_m(ARM, SKELETON, Pose(straight, wrist_extension=a))[forearm, 2].mean() for a in (0.0, 0.3)
    )
    assert high > low + 0.02


@settings(deadline=None, max_examples=20)
@given(st.tuples(ANGLES, ANGLES, ANGLES), st.tuples(ANGLES, ANGLES, ANGLES))
def test_common_motion_of_all_bones_moves_skin_rigidly(vector, offset):
    rotation = Rotation.from_rotvec(vector).as_matrix()
    rotations, translations = np.tile(rotation, (len(ARM.bones), 1, 1)), np.tile(offset, (len(ARM.bones), 1))
    expected = SKELETON.vertices_m @ rotation.T + offset
    assert np.allclose(linear_blend_skinning(SKELETON.vertices_m, ARM.weights, rotations, translations), expected)
    assert np.allclose(dual_quaternion_skinning(SKELETON.vertices_m, ARM.weights, rotations, translations), expected)


def test_skin_with_one_bone_follows_that_bone():
    rng = np.random.default_rng(0)
    rotations, translations = Rotation.random(4, random_state=1).as_matrix(), rng.normal(size=(4, 3))
    points, owner = rng.normal(size=(50, 3)), rng.integers(4, size=50)
    weights = np.eye(4)[owner]
    expected = np.einsum("vij,vj->vi", rotations[owner], points) + translations[owner]
    assert np.allclose(linear_blend_skinning(points, weights, rotations, translations), expected)
    assert np.allclose(dual_quaternion_skinning(points, weights, rotations, translations), expected)


def test_dual_quaternions_preserve_radius_and_linear_blending_does_not():
    point, weights = np.array([[1.0, 0, 0]]), np.array([[0.5, 0.5]])
    rotations = np.stack([np.eye(3), Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()])
    linear = linear_blend_skinning(point, weights, rotations, np.zeros((2, 3)))
    dual = dual_quaternion_skinning(point, weights, rotations, np.zeros((2, 3)))
    assert np.linalg.norm(dual) == pytest.approx(1)
    assert np.linalg.norm(linear) == pytest.approx(np.cos(np.pi / 4))
    assert dual[0] == pytest.approx([np.cos(np.pi / 4), np.sin(np.pi / 4), 0])


@pytest.mark.parametrize("name", sorted(POSES))
def test_pose_stretches_edges_within_bounds(name):
    pose = dataclasses.replace(POSES[name], wrist_extension=0.2, forearm_twist=0.1)
    edges = np.concatenate([ARM.quads[:, [0, 1]], ARM.quads[:, [1, 2]]])

    def lengths(vertices):
        return np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)

    stretch = lengths(posed_vertices_m(ARM, SKELETON, pose)) / lengths(SKELETON.vertices_m)
    assert np.percentile(stretch, 99) < 3
    assert np.percentile(stretch, 1) > 0.15


def test_fist_retracts_fingertips():
    tips = {
        name: posed_vertices_m(ARM, SKELETON, POSES[name])[ARM.weights[:, ARM.bone_index("finger3-3")] > 0.5, 0].max()
        for name in ("flat", "fist")
    }
    assert tips["flat"] > tips["fist"] + 0.05
