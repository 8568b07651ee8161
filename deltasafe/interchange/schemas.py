"""JSON schemas of the messages: Foxglove's, by name and fields, and four of our own.

Viewers identify a message by the name of its schema (https://docs.foxglove.dev/docs/sdk/schemas).
"""

from typing import Any

Schema = dict[str, Any]

NUMBER: Schema = {"type": "number"}
TEXT: Schema = {"type": "string"}
COUNT: Schema = {"type": "integer", "minimum": 0}
TIME: Schema = {
    "type": "object",
    "title": "time",
    "properties": {"sec": COUNT, "nsec": {**COUNT, "maximum": 999_999_999}},
}
DURATION: Schema = {**TIME, "title": "duration"}


def _record(title: str, /, **fields: Schema) -> Schema:
    return {"title": title, "type": "object", "properties": fields}


def _list(item: Schema, **limits: int) -> Schema:
    return {"type": "array", "items": item, **limits}


VECTOR = _record("foxglove.Vector3", x=NUMBER, y=NUMBER, z=NUMBER)
POINT = _record("foxglove.Point3", x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _record("foxglove.Quaternion", x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
COLOR = _record("foxglove.Color", r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
POSE = _record("foxglove.Pose", position=VECTOR, orientation=QUATERNION)
TRIANGLES = _record(
    "foxglove.TriangleListPrimitive",
    pose=POSE,
    points=_list(POINT),
    color=COLOR,
    colors=_list(COLOR),
    indices=_list(COUNT),
)
ENTITY = _record(
    "foxglove.SceneEntity",
    timestamp=TIME,
    frame_id=TEXT,
    id=TEXT,
    lifetime=DURATION,
    frame_locked={"type": "boolean"},
    triangles=_list(TRIANGLES),
)

SCHEMAS: dict[str, Schema] = {
    schema["title"]: schema
    for schema in (
        _record(
            "foxglove.CompressedImage",
            timestamp=TIME,
            frame_id=TEXT,
            data={"type": "string", "contentEncoding": "base64"},
            format=TEXT,
        ),
        _record(
            "foxglove.CameraCalibration",
            timestamp=TIME,
            frame_id=TEXT,
            width=COUNT,
            height=COUNT,
            distortion_model=TEXT,
            D=_list(NUMBER),
            K=_list(NUMBER, minItems=9, maxItems=9),
            R=_list(NUMBER, minItems=9, maxItems=9),
            P=_list(NUMBER, minItems=12, maxItems=12),
        ),
        _record(
            "foxglove.FrameTransform",
            timestamp=TIME,
            parent_frame_id=TEXT,
            child_frame_id=TEXT,
            translation=VECTOR,
            rotation=QUATERNION,
        ),
        _record("foxglove.PoseInFrame", timestamp=TIME, frame_id=TEXT, pose=POSE),
        _record("foxglove.PosesInFrame", timestamp=TIME, frame_id=TEXT, poses=_list(POSE)),
        _record("foxglove.SceneUpdate", deletions=_list({"type": "object"}), entities=_list(ENTITY)),
        _record(
            "deltasafe.JointState",
            timestamp=TIME,
            name=_list(TEXT),
            position_rad=_list(NUMBER),
            torque_nm=_list(NUMBER),
        ),
        _record(
            "deltasafe.ExecutionSample",
            timestamp=TIME,
            time_s=NUMBER,
            phase=TEXT,
            reference_pose=_list(NUMBER, minItems=4, maxItems=4),
            reference_velocity=_list(NUMBER, minItems=4, maxItems=4),
            tool_to_hand_m={"type": ["number", "null"]},
            arm_to_hand_m={"type": ["number", "null"]},
            contacts=COUNT,
            reference_speed_mps=NUMBER,
            workspace_error_m=NUMBER,
        ),
        _record(
            "deltasafe.OccupancyImage",
            timestamp=TIME,
            captured_s={"type": ["number", "null"]},
            defect=TEXT,
            width=COUNT,
            height=COUNT,
            zlib={"type": "string", "contentEncoding": "base64"},
        ),
        _record(
            "deltasafe.OnlineDecision",
            timestamp=TIME,
            now_s=NUMBER,
            tool_pose=_list({"type": ["number", "null"]}, minItems=4, maxItems=4),
            has_image={"type": "boolean"},
            kind=TEXT,
            reason=TEXT,
            rate=NUMBER,
            plan=COUNT,
            planned={"type": "boolean"},
            captured_s={"type": ["number", "null"]},
            timing_ms={"type": "object"},
        ),
    )
}
