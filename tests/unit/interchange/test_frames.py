"""Import of scenes: frames, timestamps, rotations and sizes."""

import base64
import copy
import math
import pathlib

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("mcap")

from deltasafe.errors import DataError
from deltasafe.geometry import Pose
from deltasafe.interchange import export_scene, import_scene
from deltasafe.interchange.frames import SAME_M
from deltasafe.interchange.mcap_log import open_log
from deltasafe.interchange.reading import read_log
from deltasafe.interchange.scene_import import MAX_TILT_RAD
from deltasafe.interchange.scenes import quaternion, upright, vector, yaw_about_z
from deltasafe.scene import LoggedScene

SCENE = LoggedScene.load(pathlib.Path(__file__).parents[3] / "datasets" / "scenes" / "scene_003")
SECOND = 1_000_000_000
SCHEMA = {
    "/camera/image": "foxglove.CompressedImage",
    "/camera/calibration": "foxglove.CameraCalibration",
    "/tf": "foxglove.FrameTransform",
    "/task/start": "foxglove.PoseInFrame",
    "/task/goal": "foxglove.PoseInFrame",
}


class Log:
    """An exported scene with editable messages: topic -> [(time in seconds, message)]."""

    def __init__(self, path):
        export_scene(SCENE, path)
        whole = read_log(path)
        self.path, self.facts, self.attachments = path, whole.facts, whole.attachments
        self.messages = {topic: [(0.0, copy.deepcopy(whole.messages_on(topic)[0]))] for topic in SCHEMA}
        for messages in self.messages.values():
            messages[0][1].pop("timestamp")

    def message(self, topic):
        return self.messages[topic][0][1]

    def at(self, topic, time_s):
        self.messages[topic] = [(time_s, message) for _, message in self.messages[topic]]

    def load(self):
        self.path.unlink()
        with open_log(self.path) as log:
            for topic, messages in self.messages.items():
                for time_s, message in messages:
                    log.write_message(topic, SCHEMA[topic], round(time_s * SECOND), message)
            for name, facts in self.facts.items():
                log.write_facts(name, facts)
            for name, data in self.attachments.items():
                log.attach(name, "application/octet-stream", data)
        folder = self.path.parent / "scene"
        try:
            return import_scene(self.path, folder)
        except DataError:
            assert not folder.exists()
            raise


@pytest.fixture
def log(tmp_path):
    return Log(tmp_path / "scene.mcap")


def transform(parent, child, position_m=(0.0, 0.0, 0.0), rotation=None):
    rotation = Rotation.identity() if rotation is None else rotation
    return {
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": vector(position_m),
        "rotation": quaternion(rotation.as_quat()),
    }


def turned(degrees, axis="z"):
    return Rotation.from_euler(axis, degrees, degrees=True)


CAMERA_POSE = (SCENE.camera.position_m, Rotation.from_matrix(SCENE.camera.world_from_camera_rotation))


def assert_camera_as_logged(scene, atol=1e-12):
    np.testing.assert_allclose(scene.camera.position_m, SCENE.camera.position_m, rtol=0, atol=atol)
    np.testing.assert_array_equal(
        scene.camera.world_from_camera_rotation, SCENE.camera.world_from_camera_rotation
    )  # from the metadata, if the transforms agree with it


def test_transforms_of_other_frames_are_ignored(log):
    base = transform("world", "robot_base", (0.5, 0.1, 0.7))
    log.messages["/tf"] = [(0, base), *log.messages["/tf"], (0, transform("robot_base", "tool", (0, 0, 1)))]
    assert_camera_as_logged(log.load(), atol=0)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_the_newest_transform_before_the_image_is_used(log, order):
    stamped = [
        (1.0, transform("world", "camera", (0.2, 0.0, 0.6), CAMERA_POSE[1])),
        (2.0, log.message("/tf")),
        (3.0, transform("world", "camera", (0.0, 0.2, 0.7), CAMERA_POSE[1])),
    ]
    # a recorder may write transforms late: the timestamp decides, not the position in the log
    log.messages["/tf"] = [(2.0, {"timestamp": _stamp(stamped[n][0]), **stamped[n][1]}) for n in order]
    log.at("/camera/image", 2.5)
    assert_camera_as_logged(log.load(), atol=0)


def _stamp(time_s):
    return {"sec": int(time_s), "nsec": 0}


def test_transforms_later_than_the_image_are_refused(log):
    log.at("/tf", 1.5)
    log.at("/camera/image", 1.0)
    with pytest.raises(DataError, match=r"/tf connects 'world' with 'camera' only later than 1 s"):
        log.load()


def test_a_chain_of_transforms_is_composed_in_both_directions(log):
    base, flange = ((0.4, -0.3, 0.1), turned(70)), ((0.1, 0.2, 0.5), turned(35, "x"))
    in_flange = flange[1].inv().apply(base[1].inv().apply(CAMERA_POSE[0] - base[0]) - flange[0])
    rotation = (base[1] * flange[1]).inv() * CAMERA_POSE[1]
    log.messages["/tf"] = [
        (0, transform("flange", "eye", in_flange, rotation)),
        (0, transform("base", "flange", *flange)),
        (0, transform("base", "world", -base[1].inv().apply(base[0]), base[1].inv())),
    ]
    for topic in ("/camera/image", "/camera/calibration"):
        log.message(topic)["frame_id"] = "eye"
    assert_camera_as_logged(log.load())


def test_a_camera_without_connection_to_the_world_is_refused(log):
    log.messages["/tf"] = [(0, transform("world", "robot_base")), (0, transform("stand", "camera"))]
    with pytest.raises(DataError, match=r"does not connect 'world' with 'camera'.* stand -> camera"):
        log.load()


@pytest.mark.parametrize("other", ["world", "robot_base"])
def test_contradicting_chains_are_refused(log, other):
    log.messages["/tf"] += [
        (0, transform("world", "robot_base", (0.1, 0, 0))),
        (0, transform(other, "camera", (0.0, 0.0, 0.5 + 2 * SAME_M), CAMERA_POSE[1])),
    ]
    with pytest.raises(DataError, match="'camera' two poses in 'world'"):
        log.load()


def test_consistent_chains_are_accepted_with_contradictions_elsewhere(log):
    log.messages["/tf"] += [
        (0, transform("world", "robot_base", (0.1, 0, 0))),
        (0, transform("robot_base", "camera", CAMERA_POSE[0] - (0.1, 0, 0), CAMERA_POSE[1])),
        (0, transform("robot_base", "carried", (0.3, 0, 0))),
        (0, transform("world", "carried", (0.9, 0, 0))),
    ]
    assert_camera_as_logged(log.load(), atol=0)


def test_task_poses_are_transformed_into_the_world(log):
    base, position_m = ((0.5, -0.2, 0.01), turned(90)), np.array((SCENE.goal.x_m, SCENE.goal.y_m, SCENE.goal.z_m))
    log.messages["/tf"].append((0, transform("world", "robot_base", *base)))
    local = Pose(*base[1].inv().apply(position_m - base[0]), SCENE.goal.yaw_rad + math.pi)
    log.messages["/task/goal"] = [(0, {"frame_id": "robot_base", "pose": upright(local)})]
    scene = log.load()
    np.testing.assert_allclose(scene.goal.as_array()[:3], position_m, atol=1e-12)
    assert math.remainder(scene.goal.yaw_rad - SCENE.goal.yaw_rad + math.pi / 2, 2 * math.pi) == pytest.approx(0)


@pytest.mark.parametrize("frame", ["robot_base", "", None, 5])
def test_task_poses_in_unknown_frames_are_refused(log, frame):
    log.message("/task/start")["frame_id"] = frame
    with pytest.raises(DataError, match="robot_base" if frame == "robot_base" else "/task/start needs the name"):
        log.load()


def test_a_pose_in_the_camera_frame_is_transformed(log):
    log.message("/task/goal")["frame_id"] = "camera"  # its z axis points down
    with pytest.raises(DataError, match=r"/task/goal is tilted by 180 degrees"):
        log.load()


def test_a_pose_in_a_frame_that_moved_is_refused(log):
    log.messages["/tf"] += [(0, transform("world", "cart")), (2, transform("world", "cart", (0.05, 0, 0)))]
    log.at("/camera/image", 1.0)
    log.at("/task/goal", 3.0)
    log.message("/task/goal")["frame_id"] = "cart"
    with pytest.raises(DataError, match="'cart', which moved"):
        log.load()


@pytest.mark.parametrize("topic", ["/task/start", "/task/goal"])
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("degrees", [0.2, 45, 180])
def test_tilted_task_poses_are_refused(log, topic, axis, degrees):
    log.message(topic)["pose"]["orientation"] = quaternion((turned(30) * turned(degrees, axis)).as_quat())
    with pytest.raises(DataError, match=f"{topic} is tilted by {degrees:g} degrees"):
        log.load()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_tilt_within_the_tolerance_keeps_the_yaw(log, sign):
    tilt = Rotation.from_rotvec((0.9 * MAX_TILT_RAD, 0, 0))
    log.message("/task/goal")["pose"]["orientation"] = quaternion(sign * (turned(200) * tilt).as_quat())
    assert log.load().goal.yaw_rad == pytest.approx(math.radians(-160), abs=1e-5)


def test_exported_yaw_is_read_back_exactly(log):
    for yaw_rad in [*np.random.default_rng(0).uniform(-math.pi, math.pi, 2000).tolist(), math.pi, -math.pi, 1e-300]:
        turn = upright(Pose(0, 0, 0, yaw_rad))["orientation"]
        assert math.hypot(turn["z"], turn["w"]) == pytest.approx(1, abs=1e-15)
        assert yaw_about_z(turn["z"], turn["w"]) == yaw_rad
    log.message("/task/goal")["pose"]["orientation"] = upright(Pose(0, 0, 0, 2.1))["orientation"]
    assert log.load().goal.yaw_rad == 2.1


def test_repeated_task_poses_must_be_equal(log):
    log.messages["/task/goal"].append((1.0, copy.deepcopy(log.message("/task/goal"))))
    assert log.load().goal == SCENE.goal
    log.messages["/task/goal"][1][1]["pose"]["position"]["x"] += 0.01
    (log.path.parent / "scene").rename(log.path.parent / "first")
    with pytest.raises(DataError, match="/task/goal holds 2 poses that differ"):
        log.load()


BAD_QUATERNIONS = [(0, 0, 0, 0), (0, 0, 0, 2), (0, 0, 0, 0.99), (0, 0, True, 1), (0, 0, "0", 1), (0, 0, None, 1)]


@pytest.mark.parametrize("values", [*BAD_QUATERNIONS, (0, 0, 10**400, 1)])
def test_invalid_quaternions_are_refused(log, values):
    bad = dict(zip("xyzw", values, strict=True))
    log.message("/task/goal")["pose"]["orientation"] = bad
    with pytest.raises(DataError, match=r"/task/goal (has the quaternion|needs finite numbers)"):
        log.load()
    Log.__init__(log, log.path)
    log.message("/tf")["rotation"] = bad
    with pytest.raises(DataError, match=r"/tf \(world -> camera\) (has the quaternion|needs finite numbers)"):
        log.load()


@pytest.mark.parametrize("value", [1e308, -(10**400), 10**7, None, "0.1", True])
def test_invalid_coordinates_are_refused(log, value):
    log.message("/tf")["translation"]["x"] = value
    with pytest.raises(DataError, match=r"/tf \(world -> camera\) needs finite numbers x, y, z up to"):
        log.load()


def test_a_rounded_quaternion_is_accepted(log):
    turn = quaternion(np.round(turned(33).as_quat(), 4))
    log.message("/task/goal")["pose"]["orientation"] = turn
    assert log.load().goal.yaw_rad == pytest.approx(math.radians(33), abs=1e-3)


@pytest.mark.parametrize(
    "stamp", [None, {}, {"sec": -1, "nsec": 0}, {"sec": 0, "nsec": SECOND}, {"sec": 0.5, "nsec": 0}]
)
@pytest.mark.parametrize("topic", ["/tf", "/camera/image", "/task/start"])
def test_messages_without_a_timestamp_are_refused(log, topic, stamp):
    log.message(topic)["timestamp"] = stamp
    with pytest.raises(DataError, match=f"{topic} needs a timestamp"):
        log.load()


def test_the_calibration_of_another_frame_is_refused(log):
    log.message("/camera/calibration")["frame_id"] = "camera_right"
    with pytest.raises(DataError, match="'camera_right', /camera/image of 'camera'"):
        log.load()


def test_the_calibration_is_chosen_by_frame_and_time(log):
    right = log.message("/camera/calibration")
    other, older, newer = copy.deepcopy(right), copy.deepcopy(right), copy.deepcopy(right)
    other["frame_id"] = "camera_right"
    for one in (other, older, newer):
        one["K"] = [2 * value for value in one["K"][:8]] + [1.0]
    log.messages["/camera/calibration"] = [(0, other), (1, older), (2, right), (4, newer)]
    log.at("/camera/image", 3.0)
    assert log.load().camera.fx == SCENE.camera.fx


@pytest.mark.parametrize("culprit", ["calibration", "image", "mask"])
def test_different_sizes_are_refused(log, culprit):
    small = np.full((240, 320, 3), 255, np.uint8)
    if culprit == "calibration":
        log.message("/camera/calibration").update(width=320, height=240)
    elif culprit == "image":
        data = cv2.imencode(".png", small)[1].tobytes()
        log.message("/camera/image").update(format="png", data=base64.b64encode(data).decode())
    else:
        log.attachments["hand_mask.png"] = cv2.imencode(".png", small[..., 0])[1].tobytes()
    with pytest.raises(DataError, match=r"pixels, /camera/(calibration|image) is for"):
        log.load()


def test_a_camera_rotation_without_numbers_is_refused(log):
    log.facts["deltasafe.scene"]["camera_rotation"] = [[None] * 3] * 3
    with pytest.raises(DataError, match="disagree"):
        log.load()


def test_late_timestamps_do_not_change_the_scene(log):
    for topic in SCHEMA:
        log.at(topic, 1_700_000_000.25)
    scene = log.load()
    assert (scene.start, scene.goal) == (SCENE.start, SCENE.goal)
    assert_camera_as_logged(scene, atol=0)


def test_exported_calibrations_count_pixels_as_opencv_does(log):
    points_m = np.array([[0.05, 0.02, 0.01], [-0.1, 0.0, 0.0]])
    to_camera = SCENE.camera.world_from_camera_rotation.T
    turn, shift = cv2.Rodrigues(to_camera)[0], -to_camera @ SCENE.camera.position_m
    calibration = log.message("/camera/calibration")
    by_viewers, _ = cv2.projectPoints(points_m, turn, shift, np.reshape(calibration["K"], (3, 3)), None)
    np.testing.assert_allclose(by_viewers[:, 0] + 0.5, SCENE.camera.project(points_m)[0], atol=1e-9)
    np.testing.assert_array_equal(np.reshape(calibration["P"], (3, 4))[:, :3].ravel(), calibration["K"])


def test_logs_from_before_the_half_pixel_are_read_as_they_were_meant(log):
    calibration = log.message("/camera/calibration")
    for name, places in (("K", (2, 5)), ("P", (2, 6))):
        for place in places:
            calibration[name][place] += 0.5
    del log.facts["deltasafe.scene"]["first_pixel_center"]
    scene = log.load()
    assert (scene.camera.cx, scene.camera.cy) == (SCENE.camera.cx, SCENE.camera.cy)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"P": [0.0] * 11 + [1.0]}, "R is not the identity, or P has an offset"),
        ({"R": [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]}, "R is not the identity"),
        ({"K": [700.0, 0.3, 320.0, 0.0, 700.0, 240.0, 0.0, 0.0, 1.0]}, "skew"),
        ({"K": [700.0, 0.0, 0.0, 0.0, 700.0, 0.0, 0.0, 0.0, 1.0], "P": []}, "far from the center"),
        ({"D": [-9.0, 0.0, 0.0, 0.0, 0.0]}, "would leave less than"),
    ],
)
def test_calibrations_of_other_images_are_refused(log, change, words):
    log.message("/camera/calibration").update(change)
    with pytest.raises(DataError, match=words):
        log.load()


def test_a_distorted_log_is_undistorted_with_its_mask(log):
    log.message("/camera/calibration")["D"] = [-0.1, 0.0, 0.0, 0.0, 0.0]
    scene = log.load()
    assert scene.image_path.name == "image.png"
    assert scene.camera.fx < SCENE.camera.fx  # barrel distortion: more is seen
    mask, true = (cv2.imread(str(one.mask_path), cv2.IMREAD_GRAYSCALE) for one in (scene, SCENE))
    assert set(np.unique(mask)) == {0, 255}
    assert 0.7 < (mask > 0).sum() / (true > 0).sum() < 1.1
