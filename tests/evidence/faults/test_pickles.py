"""``python -m evidence.faults.pickles`` in a process of its own: its listener stays for the life of it."""

import json
import pathlib
import subprocess
import sys


def test_no_pickle_is_loaded_by_reading_anything(tmp_path: pathlib.Path) -> None:
    record = tmp_path / "reliability.json"
    run = subprocess.run(
        [sys.executable, "-m", "evidence.faults.pickles", "--record", str(record)],
        cwd=pathlib.Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    figures = json.loads(record.read_text())["figures"]
    assert figures["pickles_loaded"] == 0
    assert figures["kinds_read"] >= 10
