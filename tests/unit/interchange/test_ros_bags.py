"""Import of ROS 2 bags, written by rosbags in both storages, and of MCAP files with ROS messages in JSON."""

import base64
import json
import math

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("mcap")
pytest.importorskip("rosbags")

from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from deltasafe.cameras import CameraModel
from deltasafe.cli import main
from deltasafe.errors import DataError
from deltasafe.geometry import Pose
from deltasafe.interchange import ImportOptions, import_scene
from deltasafe.io.images import read_rgb
from deltasafe.scene import LoggedScene
from evidence import ros_bags

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND
WIDTH, HEIGHT = 64, 48
K = [60.0, 0.0, 31.25, 0.0, 61.0, 23.75, 0.0, 0.0, 1.0]
RGB = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
DOWN = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
BASE = (np.array([0.2, -0.1, 0.0]), Rotation.from_euler("z", 0.6))
MOUNT = (np.array([0.1, 0.0, 0.7]), Rotation.from_euler("x", 0.1) * DOWN)
GIVEN = dict(table_z_m=0.0, hand_height_m=0.06, start=Pose(0.1, 0, 0.05, 0), goal=Pose(0.2, 0, 0.05, 1.0))
OPTIONS = ImportOptions(world_frame="map", **GIVEN)


def header(time_s, frame):
    return {"stamp": {"sec": int(time_s), "nanosec": round(time_s % 1 * SECOND)}, "frame_id": frame}


def xyz(values, names="xyz"):
    return dict(zip(names, map(float, values), strict=True))


def transform(parent, child, pose, time_s=10.0):
    turn = xyz(pose[1].as_quat(), "xyzw")
    link = {"translation": xyz(pose[0]), "rotation": turn}
    return {"header": header(time_s, parent), "child_frame_id": child, "transform": link}


def info(time_s=10.0, **changes):
    p = [K[0], 0.0, K[2], 0.0, 0.0, K[4], K[5], 0.0, 0.0, 0.0, 1.0, 0.0]
    roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    values = {"header": header(time_s, "eye"), "height": HEIGHT, "width": WIDTH, "distortion_model": "plumb_bob"}
    values |= {"d": [0.0] * 5, "k": K, "r": np.eye(3).ravel().tolist(), "p": p, "binning_x": 0, "binning_y": 0}
    return values | {"roi": roi} | changes


def image(time_s=10.0, encoding="rgb8", pixels=RGB, padding=0, **changes):
    rows = np.pad(pixels.reshape(HEIGHT, -1), ((0, 0), (0, padding)))
    values = {"header": header(time_s, "eye"), "height": HEIGHT, "width": WIDTH, "encoding": encoding}
    return values | {"is_bigendian": 0, "step": rows.shape[1], "data": rows.tobytes()} | changes


def png(time_s=10.0, pixels=RGB, form="png"):
    data = cv2.imencode(".png", pixels[..., ::-1])[1].tobytes()
    return {"header": header(time_s, "eye"), "format": form, "data": data}


TYPES = {
    "/cam/image": "sensor_msgs/msg/Image",
    "/cam/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/cam/camera_info": "sensor_msgs/msg/CameraInfo",
    "/other/camera_info": "sensor_msgs/msg/CameraInfo",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/goal": "geometry_msgs/msg/PoseStamped",
}


def messages(**changes):
    """Topic -> [(time of recording in seconds, message)]; the static transform is stamped after the image."""
    found = {
        "/cam/image": [(10.0, image())],
        "/cam/camera_info": [(9.9, info()), (10.1, info(10.1))],
        "/tf": [(9.5, {"transforms": [transform("base", "eye", MOUNT, 9.5), transform("base", "arm", MOUNT, 9.5)]})],
        "/tf_static": [(9.0, {"transforms": [transform("map", "base", BASE, 99.0)]})],
    }
    return {topic: value for topic, value in (found | changes).items() if value}


def write_bag(folder, content, storage=StoragePlugin.SQLITE3, compression=None):
    return ros_bags.write_bag(folder, content, TYPES, storage, compression)


def write_json_mcap(path, content, types=TYPES):
    def plain(value):
        if isinstance(value, dict):
            return {name: plain(one) for name, one in value.items()}
        if isinstance(value, bytes):
            return base64.b64encode(value).decode()
        return [plain(one) for one in value] if isinstance(value, list) else value

    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        for topic, some in content.items():
            schema = writer.register_schema(types[topic], "jsonschema", b"{}")
            channel = writer.register_channel(topic, "json", schema)
            for time_s, value in some:
                time_ns = START_NS + round(time_s * SECOND)
                writer.add_message(channel, time_ns, json.dumps(plain(value)).encode(), time_ns)
        writer.finish()
    return path


def assert_expected(scene, rgb=RGB):
    np.testing.assert_array_equal(read_rgb(scene.image_path), rgb)
    camera = scene.camera
    assert (camera.width, camera.height, camera.fx, camera.fy) == (WIDTH, HEIGHT, 60.0, 61.0)
    assert (camera.cx, camera.cy) == (31.75, 24.25)  # half a pixel more than in ROS
    np.testing.assert_allclose(camera.position_m, BASE[0] + BASE[1].apply(MOUNT[0]), atol=1e-12)
    expected = (BASE[1] * MOUNT[1]).as_matrix()
    np.testing.assert_allclose(camera.world_from_camera_rotation, expected, atol=1e-12)
    assert (scene.start, scene.goal) == (GIVEN["start"], GIVEN["goal"])
    assert (scene.id, scene.mask_path, scene.mesh_path) == ("scene", None, None)


STORAGES = {
    "sqlite3": dict(storage=StoragePlugin.SQLITE3),
    "mcap": dict(storage=StoragePlugin.MCAP),
    "sqlite3, messages compressed": dict(storage=StoragePlugin.SQLITE3, compression=CompressionMode.MESSAGE),
    "sqlite3, file compressed": dict(storage=StoragePlugin.SQLITE3, compression=CompressionMode.FILE),
    "mcap, chunks compressed": dict(storage=StoragePlugin.MCAP, compression=CompressionMode.STORAGE),
}


@pytest.mark.parametrize("how", STORAGES)
def test_a_bag_gives_the_scene_that_was_written(tmp_path, how):
    bag = write_bag(tmp_path / "bag", messages(), **STORAGES[how])
    assert_expected(import_scene(bag, tmp_path / "scene", OPTIONS))


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_the_file_of_a_bag_is_enough(tmp_path, suffix):
    storage = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
    bag = write_bag(tmp_path / "bag", messages(), storage)
    assert_expected(import_scene(bag / f"bag{suffix}", tmp_path / "scene", OPTIONS))


def test_messages_in_json_give_the_same_scene(tmp_path):
    assert_expected(import_scene(write_json_mcap(tmp_path / "log.mcap", messages()), tmp_path / "scene", OPTIONS))


GRAY = np.repeat(RGB[..., :1], 3, axis=2)
OPAQUE = np.full((HEIGHT, WIDTH, 1), 255, np.uint8)
ENCODINGS = {
    "bgr8": (RGB[..., ::-1], RGB),
    "8UC3": (RGB[..., ::-1], RGB),
    "rgba8": (np.dstack([RGB, OPAQUE]), RGB),
    "bgra8": (np.dstack([RGB[..., ::-1], OPAQUE]), RGB),
    "mono8": (RGB[..., 0], GRAY),
}


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_raw_encodings(tmp_path, encoding, padding):
    pixels, expected = ENCODINGS[encoding]
    content = messages(**{"/cam/image": [(10.0, image(encoding=encoding, pixels=pixels, padding=padding))]})
    assert_expected(import_scene(write_bag(tmp_path / "bag", content), tmp_path / "scene", OPTIONS), expected)


@pytest.mark.parametrize(("encoding", "order"), [("yuv422", "uyvy"), ("yuv422_yuy2", "yuyv")])
def test_packed_yuv_is_gray_for_neutral_chroma(tmp_path, encoding, order):
    rows = np.full((HEIGHT, WIDTH, 2), 128, np.uint8)
    rows[..., order.index("y") % 2] = 100
    content = messages(**{"/cam/image": [(10.0, image(encoding=encoding, pixels=rows))]})
    rgb = read_rgb(import_scene(write_bag(tmp_path / "bag", content), tmp_path / "scene", OPTIONS).image_path)
    np.testing.assert_allclose(rgb, (100 - 16) * 255 / 219, atol=1)


@pytest.mark.parametrize("form", ["png", "rgb8; png compressed bgr8"])
def test_compressed_images_keep_their_bytes(tmp_path, form):
    other = {"/other/camera_info": [(9.9, info(k=[2 * value for value in K]))]}
    content = messages(**{"/cam/image": None, "/cam/image/compressed": [(10.0, png(form=form))]}, **other)
    scene = import_scene(write_bag(tmp_path / "bag", content), tmp_path / "scene", OPTIONS)
    assert_expected(scene)
    assert scene.image_path.read_bytes() == png()["data"]


def test_distorted_images_are_undistorted(tmp_path):
    lens = [-0.2, 0.05, 0.001, 0.0, 0.0]
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    pixels = np.dstack([4 * u, 5 * v, 0 * u]).astype(np.uint8)
    content = messages(**{"/cam/image": [(10.0, image(pixels=pixels))], "/cam/camera_info": [(10.0, info(d=lens))]})
    scene = import_scene(write_bag(tmp_path / "bag", content), tmp_path / "scene", OPTIONS)
    model = CameraModel(WIDTH, HEIGHT, 60.0, 61.0, 31.75, 24.25, "plumb_bob", tuple(lens))
    assert scene.camera.fx == 60.0 * model.zoom != 60.0
    np.testing.assert_array_equal(read_rgb(scene.image_path), model.undistorted(pixels))


def test_raw_and_rectified_topics_use_k_and_p(tmp_path):
    p = [50.0, 0.0, 30.25, 0.0, 0.0, 52.0, 22.75, 0.0, 0.0, 0.0, 1.0, 0.0]
    content = messages(**{"/cam/camera_info": [(10.0, info(d=[-0.2, 0.05, 0.0, 0.0, 0.0], p=p))]})
    bag = write_bag(tmp_path / "bag", content)
    with pytest.raises(DataError, match="P differs from K; give --image-kind"):
        import_scene(bag, tmp_path / "scene", OPTIONS)
    rectified = import_scene(bag, tmp_path / "scene", ImportOptions(world_frame="map", image_kind="rectified", **GIVEN))
    assert (rectified.camera.fx, rectified.camera.cx) == (50.0, 30.75)
    np.testing.assert_array_equal(read_rgb(rectified.image_path), RGB)
    for topic, expected in (("/cam/image_rect_color", 50.0), ("/cam/image_raw", None)):
        TYPES[topic] = TYPES["/cam/image"]
        renamed = {topic if name == "/cam/image" else name: some for name, some in content.items()}
        scene = import_scene(write_bag(tmp_path / topic[5:], renamed), tmp_path / "scene", OPTIONS)
        assert (scene.camera.fx == 50.0) == (expected is not None)


def test_the_image_of_a_later_time_is_chosen_with_its_transforms(tmp_path):
    later = RGB[::-1].copy()
    moved = (MOUNT[0] + (0.0, 0.05, 0.0), MOUNT[1])
    content = messages()
    content["/cam/image"] += [(12.0, image(12.0)), (14.0, image(14.0, pixels=later)), (15.0, image(15.0))]
    content["/tf"] += [(13.0, {"transforms": [transform("base", "eye", moved, 13.0)]})]
    content["/tf"] += [(14.5, {"transforms": [transform("base", "eye", MOUNT, 14.5)]})]
    options = ImportOptions(world_frame="map", image_after_s=2.5, **GIVEN)
    scene = import_scene(write_bag(tmp_path / "bag", content), tmp_path / "scene", options)
    np.testing.assert_array_equal(read_rgb(scene.image_path), later)
    np.testing.assert_allclose(scene.camera.position_m, BASE[0] + BASE[1].apply(moved[0]), atol=1e-12)
    with pytest.raises(DataError, match="messages on /cam/image"):
        import_scene(tmp_path / "bag", tmp_path / "late", ImportOptions(image_after_s=9.0, **GIVEN))


def goal_message(frame, rotation=None):
    turn = Rotation.from_euler("z", 0.4) if rotation is None else rotation
    pose = {"position": xyz((0.1, 0.0, 0.05)), "orientation": xyz(turn.as_quat(), "xyzw")}
    return {"/goal": [(9.0, {"header": header(9.0, frame), "pose": pose})]}


def test_a_goal_in_another_frame_is_transformed_and_must_be_upright(tmp_path):
    options = ImportOptions(world_frame="map", **GIVEN | {"goal": "/goal"})
    bag = write_bag(tmp_path / "bag", messages(**goal_message("base")))
    scene = import_scene(bag, tmp_path / "scene", options)
    expected = BASE[0] + BASE[1].apply((0.1, 0.0, 0.05))
    np.testing.assert_allclose(scene.goal.as_array(), [*expected, 1.0], atol=1e-12)
    tilted = write_bag(tmp_path / "tilted", messages(**goal_message("base", Rotation.from_euler("x", 0.1))))
    with pytest.raises(DataError, match=r"/goal is tilted by 5\.73 degrees in the frame 'map'"):
        import_scene(tilted, tmp_path / "other", options)


def test_a_camera_file_replaces_calibration_and_transforms(tmp_path):
    content = messages(**{"/cam/camera_info": None, "/tf": None, "/tf_static": None})
    bag = write_bag(tmp_path / "bag", content)
    with pytest.raises(DataError, match="no calibration topic; record it, or give --calibration-topic or --camera"):
        import_scene(bag, tmp_path / "scene", OPTIONS)
    model = CameraModel(2 * WIDTH, 2 * HEIGHT, 120.0, 122.0, 63.5, 48.5)
    with pytest.raises(DataError, match="no transforms to place the camera; give --camera"):
        import_scene(bag, tmp_path / "scene", ImportOptions(camera=model, **GIVEN))
    rotation = (BASE[1] * MOUNT[1]).as_matrix()
    placed = model.placed(BASE[0] + BASE[1].apply(MOUNT[0]), rotation)
    assert_expected(import_scene(bag, tmp_path / "scene", ImportOptions(camera=placed, **GIVEN)))


def test_what_is_missing_is_asked_for_by_option(tmp_path):
    bag = write_bag(tmp_path / "bag", messages())
    with pytest.raises(DataError, match="give --table-z, --hand-height, --start, --goal"):
        import_scene(bag, tmp_path / "scene")
    with pytest.raises(DataError, match="'world' with 'eye', it holds base -> arm, base -> eye, map -> base"):
        import_scene(bag, tmp_path / "scene", ImportOptions(**GIVEN))
    with pytest.raises(DataError, match="'map' with 'hand'"):
        import_scene(bag, tmp_path / "scene", ImportOptions(world_frame="map", camera_frame="hand", **GIVEN))
    TYPES["/other/image"] = TYPES["/cam/image"]
    two = write_bag(tmp_path / "two", messages(**{"/other/image": [(10.0, image())]}))
    with pytest.raises(
        DataError, match=r"several image topics, \['/cam/image', '/other/image'\]; choose one with --image"
    ):
        import_scene(two, tmp_path / "scene", OPTIONS)
    named = ImportOptions(world_frame="map", image_topic="/cam/image", **GIVEN)
    assert_expected(import_scene(two, tmp_path / "scene", named))
    for topic, words in (("/tf", "holds no image"), ("/none", "no messages on /none")):
        with pytest.raises(DataError, match=words):
            import_scene(two, tmp_path / "other", ImportOptions(world_frame="map", image_topic=topic, **GIVEN))
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"/cam/image": [(10.0, image(encoding="bayer_rggb8"))]}, "bayer_rggb8.*after image_proc"),
        ({"/cam/image": [(10.0, image(encoding="mono16"))]}, "'mono16'; only rgb8"),
        ({"/cam/image": [(10.0, image(step=10))]}, "rows of 10 bytes"),
        ({"/cam/image": [(10.0, image(data=b"abc"))]}, "3 bytes instead of"),
        ({"/cam/image": [(10.0, image(width=0))]}, "0 x 48 pixels"),
        ({"/cam/image": [(10.0, image(header=header(10.0, "")))]}, "name of a frame"),
        ({"/cam/camera_info": [(10.0, info(header=header(10.0, "left")))]}, "'left', /cam/image of 'eye'"),
        ({"/cam/camera_info": [(10.0, info(width=640))]}, "pixels, /cam/camera_info is for 640 x 48"),
        ({"/cam/camera_info": [(10.0, info(binning_x=2))]}, "binning"),
        ({"/cam/camera_info": [(10.0, info(k=[*K[:2], 2.0, *K[3:]]))]}, "P differs|far from the center"),
        ({"/cam/camera_info": [(10.0, info(distortion_model="mei"))]}, "distortion model 'mei'"),
        ({"/tf": None}, "does not connect 'map' with 'eye'"),
        ({"/tf": [(9.0, {"transforms": [transform("base", "eye", MOUNT, 11.0)]})]}, "only later than 10 s"),
        (
            {"/tf": [(9.0, {"transforms": [transform("base", "eye", (MOUNT[0], Rotation.identity()), 9.0)]})]},
            "scene.json field camera",
        ),
    ],
)
def test_unusable_bags_are_refused(tmp_path, changes, words):
    bag = write_bag(tmp_path / "bag", messages(**changes))
    with pytest.raises(DataError, match=words):
        import_scene(bag, tmp_path / "scene", OPTIONS)
    assert not (tmp_path / "scene").exists()


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_damaged_bags_are_refused(tmp_path, storage):
    write_bag(tmp_path / "bag", messages(), storage)
    (file,) = [path for path in (tmp_path / "bag").iterdir() if path.suffix != ".yaml"]
    whole, random = file.read_bytes(), np.random.default_rng(0)
    refused = 0
    for _ in range(12):
        data = bytearray(whole)
        data[int(random.integers(100, 1000))] ^= 1 << int(random.integers(8))
        file.write_bytes(data)
        try:
            import_scene(tmp_path / "bag", tmp_path / "scene", OPTIONS)
        except DataError:
            refused += 1
    assert refused or storage is StoragePlugin.SQLITE3  # which has no checksum
    for data in (b"", whole[:100], whole[: len(whole) // 2]):
        file.write_bytes(data)
        with pytest.raises(DataError):
            import_scene(tmp_path / "bag", tmp_path / "scene", OPTIONS)
    (tmp_path / "bag" / "metadata.yaml").write_text("a: [")
    file.unlink()
    with pytest.raises(DataError, match="is not a readable log"):
        import_scene(tmp_path / "bag", tmp_path / "scene", OPTIONS)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    with pytest.raises(DataError, match=r"holds neither metadata\.yaml nor \.mcap"):
        import_scene(tmp_path / "bag", tmp_path / "scene", OPTIONS)


def test_bags_of_ros_1_and_messages_of_other_encodings_are_named(tmp_path):
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0")
    with pytest.raises(DataError, match="bag of ROS 1; convert it"):
        import_scene(tmp_path / "old.bag", tmp_path / "scene", OPTIONS)
    with (tmp_path / "log.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        schema = writer.register_schema("foxglove.RawImage", "protobuf", b"")
        writer.add_message(writer.register_channel("/image", "protobuf", schema), 0, b"", 0)
        writer.finish()
    with pytest.raises(DataError, match=r"no image topic, only .*'foxglove\.RawImage in protobuf'"):
        import_scene(tmp_path / "log.mcap", tmp_path / "scene", OPTIONS)


def test_logs_of_foxglove_count_pixels_as_ros_does(tmp_path):
    stamp = {"sec": 10, "nsec": 0}
    raw = {"timestamp": stamp, "frame_id": "eye", "encoding": "rgb8", "width": WIDTH, "height": HEIGHT}
    transforms = [
        {"timestamp": stamp, "parent_frame_id": parent, "child_frame_id": child, "translation": xyz(pose[0]),
         "rotation": xyz(pose[1].as_quat(), "xyzw")}
        for parent, child, pose in (("map", "base", BASE), ("base", "eye", MOUNT))
    ]  # fmt: skip
    calibration = {"timestamp": stamp, "frame_id": "eye", "width": WIDTH, "height": HEIGHT, "K": K}
    calibration |= {"distortion_model": "", "D": [], "R": [], "P": []}
    types = {"/i": "foxglove.RawImage", "/c": "foxglove.CameraCalibration", "/t": "foxglove.FrameTransforms"}
    content = {"/i": [(10.0, raw | {"step": 3 * WIDTH, "data": RGB.tobytes()})], "/c": [(10.0, calibration)]}
    content["/t"] = [(10.0, {"transforms": transforms})]
    log = write_json_mcap(tmp_path / "log.mcap", content, types)
    assert_expected(import_scene(log, tmp_path / "scene", OPTIONS))


def test_the_command_takes_every_option(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", messages())
    command = ["import", str(bag), str(tmp_path / "one"), "--world-frame", "map", "--table-z", "0"]
    assert main(command) == 1
    assert "give --hand-height, --start, --goal" in capsys.readouterr().err
    command += [
        "--hand-height",
        "0.06",
        "--start",
        "0.1",
        "0",
        "0.05",
        "0",
        "--goal",
        "0.2",
        "0",
        "0.05",
        "57.29577951308232",
    ]
    assert main([*command, "--id", "scene", "--image-topic", "/cam/image", "--camera-frame", "eye"]) == 0
    scene = LoggedScene.load(tmp_path / "one")
    assert scene.goal.yaw_rad == pytest.approx(1.0)
    assert math.isclose(scene.camera.cx, 31.75)
    calibration = {"image_width": WIDTH, "image_height": HEIGHT, "K": [K[:3], K[3:6], K[6:]], "D": [0.0] * 5}
    (tmp_path / "c.json").write_text(json.dumps(calibration))
    assert main([*command, "--camera", str(tmp_path / "c.json"), "--at", "0"]) == 0
    assert LoggedScene.load(tmp_path / "one").id == "one"
