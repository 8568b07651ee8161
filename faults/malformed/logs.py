"""MCAP logs of scenes: cut short, bent, without what a scene needs, or saying what cannot be."""

import base64
import copy
import pathlib
from collections.abc import Callable
from random import Random
from typing import Any

from deltasafe.interchange import export_scene, import_scene
from deltasafe.interchange.mcap_log import open_log, read_log
from deltasafe.interchange.scenes import CALIBRATION, FACTS, GOAL, IMAGE, MASK, MESH, START, TRANSFORM
from deltasafe.interchange.schemas import SCHEMAS
from deltasafe.scene import LoggedScene
from faults.judging import Case, Door, rewrite
from faults.malformed.files import at, file_spoils

__all__ = ["log_cases"]

Change = Callable[[pathlib.Path, Random], None]
SCHEMA = {
    IMAGE: "foxglove.CompressedImage",
    CALIBRATION: "foxglove.CameraCalibration",
    TRANSFORM: "foxglove.FrameTransform",
    START: "foxglove.PoseInFrame",
    GOAL: "foxglove.PoseInFrame",
}


def log_cases(home: pathlib.Path, scene: pathlib.Path) -> list[Case]:
    """A log for `import_scene` and ``deltasafe import``."""
    sound = home / "scene.mcap"
    export_scene(LoggedScene.load(scene), sound)

    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        import_scene(given, out / "scene")

    door = Door("log", sound, read, lambda given, out: ["import", str(given), str(out / "scene")])
    data = sound.read_bytes()
    spoils = dict(file_spoils())
    for share in (0.001, 0.01, 0.2, 0.7, 0.95, 0.999):
        spoils[f"cut at {share:g}"] = _holding(data[: int(share * len(data))])
    for n in range(8):  # inside of the first chunk, which its checksum covers
        spoils[f"a byte changed, {n}"] = _bent
    for name, change in _contents().items():
        spoils[name] = _said(change)
    return [Case(name, door, at("", change)) for name, change in spoils.items()]


def _holding(data: bytes) -> Change:
    return lambda path, _: rewrite(path, data)


def _bent(path: pathlib.Path, random: Random) -> None:
    data = bytearray(path.read_bytes())
    place = random.randrange(300, len(data) // 3)
    data[place] ^= 1 << random.randrange(8)
    rewrite(path, bytes(data))


Said = dict[str, dict[str, Any]]
Telling = Callable[[Said, Said, dict[str, bytes]], Any]


def _said(change: Telling) -> Change:
    """The log written again, with other messages, facts or attachments."""

    def spoil(path: pathlib.Path, random: Random) -> None:
        whole = read_log(path)
        messages = {topic: copy.deepcopy(whole.messages[topic][0]) for topic in SCHEMA}
        facts, attachments = copy.deepcopy(whole.facts), dict(whole.attachments)
        change(messages, facts, attachments)
        path.unlink()
        with open_log(path) as log:
            for topic, message in messages.items():
                log.write_message(topic, SCHEMA[topic], 0, message)
            for name, fact in facts.items():
                log.write_facts(name, fact)
            for name, data in attachments.items():
                log.attach(name, "application/octet-stream", data)

    assert set(SCHEMA.values()) <= set(SCHEMAS)
    return spoil


def _without_message(topic: str) -> Telling:
    return lambda said, facts, files: said.pop(topic)


def _without_fact(name: str) -> Telling:
    return lambda said, facts, files: facts[FACTS].pop(name)


def _without_file(name: str) -> Telling:
    return lambda said, facts, files: files.pop(name)


def _fact(name: str, value: Any) -> Telling:
    return lambda said, facts, files: facts[FACTS].update({name: value})


def _message(topic: str, key: str, value: Any) -> Telling:
    return lambda said, facts, files: said[topic].update({key: value})


def _turned(turn: dict[str, float]) -> Telling:
    return lambda said, facts, files: said[GOAL]["pose"].update(orientation=turn)


def _contents() -> dict[str, Telling]:
    spoils: dict[str, Telling] = {}
    for topic in SCHEMA:
        spoils[f"without {topic}"] = _without_message(topic)
    for name in ("id", "table_z_m", "hand_height_m"):
        spoils[f"without the fact {name}"] = _without_fact(name)
    for name in (MASK, MESH):
        spoils[f"without {name}"] = _without_file(name)
    spoils["without facts"] = lambda said, facts, files: facts.clear()
    spoils["a mesh that is none"] = lambda said, facts, files: files.update({MESH: b"PK\x03\x04nothing"})
    facts_wrong: list[tuple[str, Any]] = [
        ("id", "../../escaped"),
        ("id", "/etc/escaped"),
        ("id", 7),
        ("table_z_m", "low"),
        ("table_z_m", 600.0),
        ("hand_height_m", -1.0),
        ("hand_height_m", None),
        ("camera_rotation", [[1.0, 0, 0]]),
        ("camera_rotation", "level"),
        ("camera_rotation", [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]),
    ]
    for name, value in facts_wrong:
        spoils[f"the fact {name} is {value!r}"] = _fact(name, value)
    wrong: list[tuple[str, str, Any]] = [
        (IMAGE, "format", "webp"),
        (IMAGE, "format", None),
        (IMAGE, "data", "no base64!"),
        (IMAGE, "data", 5),
        (CALIBRATION, "K", []),
        (CALIBRATION, "K", [0.0] * 9),
        (CALIBRATION, "K", "matrix"),
        (CALIBRATION, "K", [1.0, None]),
        (CALIBRATION, "D", [0.1, 0.0, 0.0, 0.0, 0.0]),
        (CALIBRATION, "D", None),
        (CALIBRATION, "width", 0),
        (CALIBRATION, "width", "640"),
        (CALIBRATION, "height", -1),
        (TRANSFORM, "rotation", {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}),
        (TRANSFORM, "rotation", {"x": 1.0}),
        (TRANSFORM, "rotation", []),
        (TRANSFORM, "translation", {"x": 0.0, "y": 0.0, "z": -1.0}),
        (TRANSFORM, "translation", {"x": 0.0, "y": 0.0, "z": "high"}),
        (TRANSFORM, "translation", None),
        (TRANSFORM, "rotation", {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.1}),
        (TRANSFORM, "translation", {"x": 0.0, "y": 0.0, "z": 10**400}),
        (TRANSFORM, "parent_frame_id", "robot_base"),
        (TRANSFORM, "child_frame_id", "robot_base"),
        (TRANSFORM, "child_frame_id", None),
        (TRANSFORM, "timestamp", {"sec": 1, "nsec": 0}),
        (TRANSFORM, "timestamp", {"sec": "now"}),
        (IMAGE, "frame_id", "camera_right"),
        (IMAGE, "frame_id", "world"),
        (CALIBRATION, "frame_id", "camera_right"),
        (CALIBRATION, "width", 641),
        (START, "frame_id", "camera"),
        (START, "frame_id", "robot_base"),
        (GOAL, "frame_id", None),
        (START, "pose", None),
        (START, "pose", {"position": {"x": 0.0}}),
        (GOAL, "pose", "there"),
        (GOAL, "pose", []),
    ]
    for topic, key, value in wrong:
        spoils[f"{topic}.{key} is {value!r:.50}"] = _message(topic, key, value)
    spoils["start in millimetres"] = lambda said, facts, files: said[START]["pose"]["position"].update(x=-150.0)
    for name, turn in {
        "tilted": {"x": 0.38268343, "y": 0.0, "z": 0.0, "w": 0.92387953},
        "upside down": {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0},
        "not of unit length": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.5},
        "zero": dict.fromkeys("xyzw", 0.0),
    }.items():
        spoils[f"goal whose rotation is {name}"] = _turned(turn)
    spoils["image that is no base64 at its end"] = lambda said, facts, files: said[IMAGE].update(
        data=base64.b64encode(b"jpeg").decode() + "?"
    )
    return spoils
