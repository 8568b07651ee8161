"""JSON records that several commands share."""

from deltasafe.io.storage import read_json, write_json
from pipelines.commands.records import merge_part


def test_a_part_replaces_its_own_figures_and_keeps_others(tmp_path):
    record = tmp_path / "safety.json"
    write_json(record, {"figures": {"executions": 3000}, "parts": {"other": {"command": "b", "seeds": {"s": 2}}}})
    merge_part(record, "mine", {"coverage": 0.9, "gone": 1.0}, command="a", seeds={"first": 0}, settings={"n": 1})
    merge_part(record, "mine", {"coverage": 0.99}, command="a --more", seeds={"first": 1})
    stored = read_json(record)
    assert stored["figures"] == {"executions": 3000, "coverage": 0.99}
    assert stored["command"] == "a --more; b"
    assert stored["seeds"] == {"mine": {"first": 1}, "other": {"s": 2}}
    assert stored["parts"]["mine"]["figures"] == {"coverage": 0.99}
    assert "settings" not in stored["parts"]["mine"]
    assert stored["commit"]
    assert stored["machine"]
