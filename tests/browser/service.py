"""`make ui` as a test starts it, and the browser that looks at it."""

import contextlib
import os
import pathlib
import shutil
import socket
import subprocess
import sys
import time
import urllib.request

ROOT = pathlib.Path(__file__).parents[2]
CHROMIUM_VARIABLE = "DELTASAFE_CHROMIUM"
INSTALLED = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PATIENT_MS = 180_000
"""For what a page shows by itself; the end of a run is waited for as long as it takes."""


def find_chromium(playwright):
    """The program that is named or installed, or else Playwright's own; None if there is none."""
    named = os.environ.get(CHROMIUM_VARIABLE) or next(filter(None, map(shutil.which, INSTALLED)), None)
    found = named or playwright.chromium.executable_path
    return found if pathlib.Path(found).is_file() else None


@contextlib.contextmanager
def serve(home, preset, log):
    """The address of the Dagster UI on a home, with MLflow's beside it, until the block is left."""
    dagster, mlflow = _free_port(), _free_port()
    elsewhere = ("DAGSTER_HOME", "MLFLOW_TRACKING_URI", "DELTASAFE_DAGSTER_UI", "DELTASAFE_MLFLOW_UI")
    environment = {name: value for name, value in os.environ.items() if name not in elsewhere}
    environment |= {"DELTASAFE_HOME": str(home), "DELTASAFE_PRESET": preset}
    command = [sys.executable, "-m", "pipelines.ui", "--port", str(dagster), "--mlflow-port", str(mlflow)]
    with log.open("w") as opened:
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=opened, stderr=opened)
    try:
        for port in (dagster, mlflow):
            while not _answers(f"http://127.0.0.1:{port}/"):
                assert process.poll() is None, log.read_text()[-4000:]
                time.sleep(0.5)
        yield f"http://127.0.0.1:{dagster}"
    finally:
        process.terminate()
        process.wait()


def _free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _answers(address):
    with contextlib.suppress(OSError), urllib.request.urlopen(address, timeout=5):
        return True
    return False
