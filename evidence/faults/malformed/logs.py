"""Corruptions of MCAP logs of scenes: truncated, with flipped bits, incomplete, or with invalid values."""

import base64
import copy
import pathlib
from collections.abc import Sequence
from random import Random
from typing import Any

from deltasafe.interchange import export_scene, import_scene
from deltasafe.interchange.mcap_log import open_log
from deltasafe.interchange.reading import read_log
from deltasafe.interchange.scenes import CALIBRATION, FACTS, GOAL, IMAGE, MESH, START, TRANSFORM
from deltasafe.scene import LoggedScene
from evidence.faults.malformed.documents import set_in
from evidence.faults.malformed.files import file_cases, file_changes, filled
from evidence.faults.rejection import Case, Change, InputKind, rewrite

SCHEMA = {
    IMAGE: "foxglove.CompressedImage",
    CALIBRATION: "foxglove.CameraCalibration",
    TRANSFORM: "foxglove.FrameTransform",
    START: "foxglove.PoseInFrame",
    GOAL: "foxglove.PoseInFrame",
}
FACT_VALUES: tuple[tuple[str, list[Any]], ...] = (
    ("id", ["../../escaped", "/etc/escaped", 7]),
    ("table_z_m", ["low", 600.0]),
    ("hand_height_m", [-1.0, None]),
    ("first_pixel_center", ["corner", 7.0, None]),
    ("camera_rotation", [[[1.0, 0, 0]], "level", [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]]),
)


def _vector(z: Any) -> dict[str, Any]:
    return {"x": 0.0, "y": 0.0, "z": z}


def _quaternion(x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 0.0) -> dict[str, float]:
    return {"x": x, "y": y, "z": z, "w": w}


MESSAGE_VALUES: tuple[tuple[str, str, list[Any]], ...] = (
    (IMAGE, "format", ["webp", None]),
    (IMAGE, "frame_id", ["camera_right", "world"]),
    (IMAGE, "data", ["no base64!", 5]),
    (CALIBRATION, "K", [[], [0.0] * 9, "matrix", [1.0, None]]),
    (CALIBRATION, "D", [[0.1, 0.0], [-9.0, 0.0, 0.0, 0.0, 0.0], None]),
    (CALIBRATION, "P", [[1.0] * 12, [1.0], "matrix"]),
    (CALIBRATION, "R", [[0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]]),
    (CALIBRATION, "distortion_model", ["double_sphere", 5]),
    (CALIBRATION, "frame_id", ["camera_right"]),
    (CALIBRATION, "width", [0, "640", 641]),
    (CALIBRATION, "height", [-1]),
    (TRANSFORM, "rotation", [_quaternion(), _quaternion(w=1.1), {"x": 1.0}, []]),
    (TRANSFORM, "parent_frame_id", ["robot_base"]),
    (TRANSFORM, "child_frame_id", ["robot_base", None]),
    (TRANSFORM, "timestamp", [{"sec": 1, "nsec": 0}, {"sec": "now"}]),
    (
        TRANSFORM,
        "translation",
        [_vector(-1.0), _vector("high"), _vector(10**400), None],
    ),
    (START, "frame_id", ["camera", "robot_base"]),
    (GOAL, "frame_id", [None]),
    (START, "pose", [None, {"position": {"x": 0.0}}]),
    (GOAL, "pose", ["there", []]),
)

GOAL_ROTATIONS = {
    "tilted": _quaternion(x=0.38268343, w=0.92387953),
    "upside down": _quaternion(x=1.0),
    "not of unit length": _quaternion(w=0.5),
    "zero": _quaternion(),
}


def log_cases(home: pathlib.Path, scene: pathlib.Path) -> list[Case]:
    """A log of a scene, as `import_scene` and ``deltasafe import`` read it."""
    valid = home / "scene.mcap"
    export_scene(LoggedScene.load(scene), valid)
    kind = InputKind(
        "log",
        valid,
        lambda given, out: import_scene(given, out / "scene"),
        lambda given, out: ["import", str(given), str(out / "scene")],
    )
    data = valid.read_bytes()
    changes = dict(file_changes())
    for fraction in (0.001, 0.01, 0.2, 0.7, 0.95, 0.999):
        changes[f"truncated at {fraction:g}"] = filled(data[: int(fraction * len(data))])
    for n in range(8):
        changes[f"a flipped bit, {n}"] = _bit_flipped
    return file_cases(kind, changes | _edits())


def _bit_flipped(path: pathlib.Path, random: Random) -> None:
    """Flip one bit of the first chunk, which a checksum covers."""
    data = bytearray(path.read_bytes())
    data[random.randrange(300, len(data) // 3)] ^= 1 << random.randrange(8)
    rewrite(path, bytes(data))


def _edited(keys: Sequence[str], value: Any = None, *, remove: bool = False) -> Change:
    """Write the log again with one value of its messages, facts or attachments set or removed."""

    def change(path: pathlib.Path, random: Random) -> None:
        whole = read_log(path)
        log: dict[str, Any] = {
            "messages": {topic: copy.deepcopy(whole.messages[topic][0]) for topic in SCHEMA},
            "facts": copy.deepcopy(whole.facts),
            "files": dict(whole.attachments),
        }
        set_in(log, keys, value, remove=remove)
        path.unlink()
        with open_log(path) as opened:
            for topic, message in log["messages"].items():
                opened.write_message(topic, SCHEMA[topic], 0, message)
            for name, fact in log["facts"].items():
                opened.write_facts(name, fact)
            for name, data in log["files"].items():
                opened.attach(name, "application/octet-stream", data)

    return change


def _edits() -> dict[str, Change]:
    def fact(name: str, value: Any) -> Change:
        return _edited(("facts", FACTS, name), value)

    def message(topic: str, *keys: str, value: Any) -> Change:
        return _edited(("messages", topic, *keys), value)

    no_base64 = base64.b64encode(b"jpeg").decode() + "?"
    removed = {
        **{topic: ("messages", topic) for topic in SCHEMA},
        **{f"the fact {name}": ("facts", FACTS, name) for name in ("id", "table_z_m", "hand_height_m")},
    }
    return {
        **{f"without {name}": _edited(keys, remove=True) for name, keys in removed.items()},
        "without facts": _edited(("facts",), {}),
        "a mesh that is not a zip": _edited(("files", MESH), b"PK\x03\x04nothing"),
        **{f"the fact {name} is {value!r}": fact(name, value) for name, values in FACT_VALUES for value in values},
        **{
            f"{topic}.{key} is {value!r:.50}": message(topic, key, value=value)
            for topic, key, values in MESSAGE_VALUES
            for value in values
        },
        **{
            f"goal whose rotation is {name}": message(GOAL, "pose", "orientation", value=value)
            for name, value in GOAL_ROTATIONS.items()
        },
        "start in millimeters": message(START, "pose", "position", "x", value=-150.0),
        "image with invalid base64 at its end": message(IMAGE, "data", value=no_base64),
    }
