"""MCAP: round trips of scenes and executions, schemas for viewers, and damaged files."""

import base64
import dataclasses
import importlib.util
import json
import pathlib
import sys

import numpy as np
import pytest

from deltasafe.cli import main
from deltasafe.errors import DataError, SettingsError
from deltasafe.execution import Execution
from deltasafe.execution.recording import PHASES
from deltasafe.interchange import export_execution, export_scene, import_execution, import_scene
from deltasafe.interchange.mcap_log import open_log
from deltasafe.interchange.reading import read_log
from deltasafe.planning import ToolBody
from deltasafe.scene import LoggedScene

needs_mcap = pytest.mark.skipif(importlib.util.find_spec("mcap") is None, reason="the extra mcap is not installed")
SCENE = LoggedScene.load(pathlib.Path(__file__).parents[3] / "datasets" / "scenes" / "scene_003")


@pytest.fixture
def execution():
    rng, count = np.random.default_rng(0), 30
    turn = rng.normal(size=(count, 4))
    return Execution(
        time_s=np.arange(count) / 100,
        phase=np.repeat([0, 2, 4], 10),
        reference_poses=rng.normal(size=(count, 4)),
        reference_velocities=rng.normal(size=(count, 4)),
        tool_positions_m=rng.normal(size=(count, 3)),
        tool_quaternions=turn / np.linalg.norm(turn, axis=1)[:, None],
        joint_positions_rad=rng.normal(size=(count, 7)),
        torques_nm=rng.normal(size=(count, 7)),
        tool_to_hand_m=rng.random(count),
        arm_to_hand_m=np.where(np.arange(count) < 5, np.inf, 0.3),
        contacts=rng.integers(0, 3, count),
        body=ToolBody(),
        seed=7,
        stop_reason="pushed",
    )


@needs_mcap
def test_an_imported_scene_equals_the_exported_one(tmp_path):
    export_scene(SCENE, tmp_path / "scene.mcap")
    back = import_scene(tmp_path / "scene.mcap", tmp_path / "scene")
    for name in ("image_path", "mask_path", "mesh_path"):
        assert getattr(back, name).read_bytes() == getattr(SCENE, name).read_bytes()
    assert (back.id, back.table_z_m, back.hand_height_m) == (SCENE.id, SCENE.table_z_m, SCENE.hand_height_m)
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        assert getattr(back.camera, name) == getattr(SCENE.camera, name)
    np.testing.assert_array_equal(back.camera.position_m, SCENE.camera.position_m)
    np.testing.assert_array_equal(back.camera.world_from_camera_rotation, SCENE.camera.world_from_camera_rotation)
    assert (back.start, back.goal) == (SCENE.start, SCENE.goal)


@needs_mcap
def test_a_scene_without_ground_truth_is_exported_and_imported(tmp_path):
    bare = dataclasses.replace(SCENE, mask_path=None, mesh_path=None)
    export_scene(bare, tmp_path / "scene.mcap")
    assert "/truth/hand" not in read_log(tmp_path / "scene.mcap").messages
    back = import_scene(tmp_path / "scene.mcap", tmp_path / "scene")
    assert (back.mask_path, back.mesh_path) == (None, None)
    assert (back.start, back.goal) == (SCENE.start, SCENE.goal)


@needs_mcap
def test_an_imported_execution_is_identical_and_exports_are_reproducible(tmp_path, execution):
    export_execution(execution, tmp_path / "one.mcap", SCENE)
    export_execution(execution, tmp_path / "two.mcap", SCENE)
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "two.mcap").read_bytes()
    back = import_execution(tmp_path / "one.mcap")
    assert back.digest() == execution.digest()
    assert back.stop_reason == "pushed"
    assert np.isinf(back.arm_to_hand_m[:5]).all()


@needs_mcap
@pytest.mark.parametrize(
    ("topic", "change"),
    [
        ("/tool/pose", {"frame_id": "flange"}),
        ("/tool/pose", {"timestamp": {"sec": 9, "nsec": 0}}),
        ("/tool/reference", {"pose": {}}),
        ("/joint_states", {"name": [f"joint_{number}" for number in (2, 1, 3, 4, 5, 6, 7)]}),
        ("/execution", {"reference_speed_mps": 9.0}),
        ("/execution", {"workspace_error_m": 0}),
        ("/execution", {"time_s": "0.03"}),
        ("/execution", {"time_s": 10**400}),
        ("/execution", {"contacts": 2**40}),
        ("/execution", {"contacts": 0.5}),
        ("/path/executed", {"frame_id": "flange"}),
    ],
)
def test_an_altered_execution_is_refused(tmp_path, execution, topic, change):
    export_execution(execution, tmp_path / "run.mcap")
    whole = read_log(tmp_path / "run.mcap")
    with open_log(tmp_path / "other.mcap") as log:
        for name, messages in whole.messages.items():
            for n, message in enumerate(messages):
                changed = change if name == topic and n == len(messages[:4]) - 1 else {}
                time_ns = message["timestamp"]["sec"] * 1_000_000_000 + message["timestamp"]["nsec"]
                log.write_message(name, "foxglove.PoseInFrame", time_ns, message | changed)
        for name, facts in whole.facts.items():
            log.write_facts(name, facts)
    with pytest.raises(DataError, match=r"export (it|the execution) again"):
        import_execution(tmp_path / "other.mcap")


@needs_mcap
def test_messages_match_the_schemas_of_viewers(tmp_path, execution):
    from mcap.reader import make_reader

    export_execution(execution, tmp_path / "run.mcap", SCENE)
    with (tmp_path / "run.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    schemas = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert schemas["/camera/image"] == "foxglove.CompressedImage"
    assert schemas["/camera/calibration"] == "foxglove.CameraCalibration"
    assert schemas["/tf"] == "foxglove.FrameTransform"
    assert schemas["/tool/pose"] == "foxglove.PoseInFrame"
    assert schemas["/path/executed"] == "foxglove.PosesInFrame"
    assert schemas["/truth/hand"] == "foxglove.SceneUpdate"
    for schema in summary.schemas.values():
        assert schema.encoding == "jsonschema"
        assert json.loads(schema.data)["title"] == schema.name
    assert {channel.message_encoding for channel in summary.channels.values()} == {"json"}
    log = read_log(tmp_path / "run.mcap")
    assert len(log.messages_on("/joint_states")) == len(execution.time_s)
    assert log.messages_on("/joint_states")[3]["timestamp"] == {"sec": 0, "nsec": 30_000_000}
    (image,) = log.messages_on("/camera/image")
    assert base64.b64decode(image["data"]) == SCENE.image_path.read_bytes()
    assert log.messages_on("/execution")[-1]["phase"] == PHASES[4]
    by_name = {schema.name: json.loads(schema.data)["properties"] for schema in summary.schemas.values()}
    for topic, messages in log.messages.items():
        allowed = set(by_name[schemas[topic]]) | {"timestamp"}
        assert all(set(message) <= allowed for message in messages), topic


@needs_mcap
def test_damaged_and_foreign_files_are_refused(tmp_path, execution):
    with pytest.raises(DataError, match="is missing"):
        read_log(tmp_path / "none.mcap")
    (tmp_path / "text.mcap").write_text("no log at all")
    with pytest.raises(DataError, match="not a readable log"):
        read_log(tmp_path / "text.mcap")
    export_execution(execution, tmp_path / "run.mcap")
    whole = (tmp_path / "run.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DataError):
        import_execution(tmp_path / "cut.mcap")
    middle = len(whole) // 3
    (tmp_path / "bent.mcap").write_bytes(whole[:middle] + bytes([whole[middle] ^ 0x55]) + whole[middle + 1 :])
    with pytest.raises(DataError):
        import_execution(tmp_path / "bent.mcap")
    with pytest.raises(DataError, match="has no image topic"):
        import_scene(tmp_path / "run.mcap", tmp_path / "scene")
    export_scene(SCENE, tmp_path / "scene.mcap")
    with pytest.raises(DataError, match=r"deltasafe\.execution"):
        import_execution(tmp_path / "scene.mcap")
    with pytest.raises(SettingsError, match=r"\.mcap"):
        export_scene(SCENE, tmp_path / "scene.bag")
    assert not (tmp_path / "scene").exists()


@needs_mcap
def test_a_flipped_bit_is_refused_or_has_no_effect(tmp_path, execution):
    export_execution(execution, tmp_path / "run.mcap")
    whole, rng, refused = (tmp_path / "run.mcap").read_bytes(), np.random.default_rng(0), 0
    for place in rng.integers(0, len(whole), 300):
        bent = bytearray(whole)
        bent[place] ^= 1 << rng.integers(8)
        (tmp_path / "bent.mcap").write_bytes(bent)
        try:
            assert import_execution(tmp_path / "bent.mcap").digest() == execution.digest()  # in the index
        except DataError:
            refused += 1
    assert refused > 200


@needs_mcap
def test_flipped_bits_in_attachments_and_metadata_are_refused(tmp_path):
    export_scene(SCENE, tmp_path / "scene.mcap")
    whole = (tmp_path / "scene.mcap").read_bytes()
    for part in (SCENE.mask_path.read_bytes(), SCENE.mesh_path.read_bytes(), b"hand_height_m"):
        place = whole.index(part) + len(part) // 2
        (tmp_path / "bent.mcap").write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(DataError, match="not a readable log"):
            import_scene(tmp_path / "bent.mcap", tmp_path / "scene")


@needs_mcap
@pytest.mark.parametrize("use_chunking", [True, False])
@pytest.mark.parametrize("options", ["no index", "no summary"])
def test_a_log_without_an_index_is_read(tmp_path, options, use_chunking):
    from mcap.reader import make_reader
    from mcap.writer import IndexType, Writer

    export_scene(SCENE, tmp_path / "scene.mcap")
    less = {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False, "use_summary_offsets": False}
    given = less if options == "no summary" else {}
    with (tmp_path / "scene.mcap").open("rb") as source, (tmp_path / "bare.mcap").open("wb") as target:
        reader = make_reader(source)
        writer = Writer(target, index_types=IndexType.NONE, use_chunking=use_chunking, **given)
        writer.start()
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        channels = {}
        for schema, channel, message in reader.iter_messages():
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "json", number)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        for record in reader.iter_attachments():
            writer.add_attachment(0, 0, record.name, record.media_type, record.data)
        writer.finish()
    assert import_scene(tmp_path / "bare.mcap", tmp_path / "scene").goal == SCENE.goal


@needs_mcap
def test_messages_are_sorted_by_time(tmp_path):
    with open_log(tmp_path / "log.mcap") as log:
        for time_ns in (5, 2, 9, 2):
            log.write_message("/task/goal", "foxglove.PoseInFrame", time_ns, {"frame_id": "world"})
    assert [one["timestamp"]["nsec"] for one in read_log(tmp_path / "log.mcap").messages_on("/task/goal")] == [
        2,
        2,
        5,
        9,
    ]


@needs_mcap
def test_a_failed_export_leaves_no_file(tmp_path):
    with pytest.raises(RuntimeError, match="interrupted"), open_log(tmp_path / "log.mcap") as log:
        log.write_message("/tool/pose", "foxglove.PoseInFrame", 0, {"frame_id": "world"})
        raise RuntimeError("interrupted")
    assert list(tmp_path.iterdir()) == []


@needs_mcap
def test_command_line_exports_and_imports(tmp_path, execution, capsys):
    execution.save(tmp_path / "run")
    scene = str(SCENE.image_path.parent)
    assert main(["export", str(tmp_path / "run"), str(tmp_path / "run.mcap"), "--scene", scene]) == 0
    assert import_execution(tmp_path / "run.mcap").digest() == execution.digest()
    assert main(["export", scene, str(tmp_path / "scene.mcap")]) == 0
    assert main(["import", str(tmp_path / "scene.mcap"), str(tmp_path / "back")]) == 0
    assert LoggedScene.load(tmp_path / "back").id == SCENE.id
    assert main(["export", str(tmp_path), str(tmp_path / "x.mcap")]) == 1
    assert "neither" in capsys.readouterr().err


@needs_mcap
def test_commands_write_over_no_other_file_or_folder(tmp_path, capsys):
    scene = SCENE.image_path.parent
    assert main(["export", str(scene), str(tmp_path / "scene.json")]) == 1
    assert "scene.json: must end in .mcap" in capsys.readouterr().err
    assert main(["export", str(scene), str(tmp_path / "scene.mcap")]) == 0
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "final.tex").write_text("years of work")
    assert main(["import", str(tmp_path / "scene.mcap"), str(tmp_path / "thesis")]) == 1
    assert "exists and is no scene" in capsys.readouterr().err
    assert (tmp_path / "thesis" / "final.tex").read_text() == "years of work"
    (tmp_path / "empty").mkdir()
    for folder in ("empty", "empty"):  # the second time it is a scene
        assert main(["import", str(tmp_path / "scene.mcap"), str(tmp_path / folder)]) == 0


def test_a_missing_package_is_named_with_its_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match="pip install"):
        export_scene(SCENE, tmp_path / "scene.mcap")
