"""Servers that tests start on this machine: ports for them, whether they answer, and `make ui` as a whole."""

import contextlib
import os
import pathlib
import socket
import subprocess
import sys
import time
import urllib.request

ROOT = pathlib.Path(__file__).parents[1]


def free_ports(count):
    """Return free TCP ports."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]


def answers(address):
    """Whether a server there has something to say."""
    with contextlib.suppress(OSError), urllib.request.urlopen(address, timeout=5):
        return True
    return False


@contextlib.contextmanager
def serve(home, preset, log):
    """The addresses of the Dagster UI on a home and of MLflow's beside it, until the block is left."""
    ports = free_ports(2)
    elsewhere = ("DAGSTER_HOME", "MLFLOW_TRACKING_URI", "DELTASAFE_DAGSTER_UI", "DELTASAFE_MLFLOW_UI")
    environment = {name: value for name, value in os.environ.items() if name not in elsewhere}
    environment |= {"DELTASAFE_HOME": str(home), "DELTASAFE_PRESET": preset}
    dagster, mlflow = map(str, ports)
    command = [sys.executable, "-m", "pipelines.commands.ui", "--port", dagster, "--mlflow-port", mlflow]
    with log.open("w") as opened:
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=opened, stderr=opened)
    try:
        addresses = [f"http://127.0.0.1:{port}" for port in ports]
        for address in addresses:
            while not answers(address):
                assert process.poll() is None, log.read_text()[-4000:]
                time.sleep(0.5)
        yield addresses
    finally:
        process.terminate()
        process.wait()
