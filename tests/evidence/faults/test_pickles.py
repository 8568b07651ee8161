"""``evidence.faults.pickles`` in its own process, because its audit hook cannot be removed."""

import json
import pathlib
import subprocess
import sys

from pipelines.home import PROJECT


def test_reading_inputs_loads_no_pickle(tmp_path: pathlib.Path) -> None:
    record = tmp_path / "reliability.json"
    command = [sys.executable, "-m", "evidence.faults.pickles", "--record", str(record)]
    run = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    figures = json.loads(record.read_text())["figures"]
    assert figures["pickles_loaded"] == 0
    assert figures["kinds_read"] >= 10
