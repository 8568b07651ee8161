"""`make ui` is for this machine alone: every socket that it listens at has a loopback address."""

import ipaddress
import os
import pathlib
import signal
import socket
import subprocess
import sys
import time
import urllib.request

import pytest

ROOT = pathlib.Path(__file__).parents[2]
LISTENS = "0A"


def listening(marker):
    """Addresses and ports (TCP) that processes with the text ``marker`` in their environment listen at."""
    sockets = set()
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            if marker not in (process / "environ").read_bytes().split(b"\0"):
                continue
            sockets |= {str(file.readlink()) for file in (process / "fd").iterdir()}
        except OSError:
            continue
    found = set()
    for table in ("tcp", "tcp6"):
        for line in (pathlib.Path("/proc/net") / table).read_text().splitlines()[1:]:
            _, local, _, state, *_, inode = line.split()[:10]
            if state == LISTENS and f"socket:[{inode}]" in sockets:
                address, port = local.split(":")
                found.add((parsed(address), int(port, 16)))
    return found


def parsed(address):
    """Of /proc/net: words of four bytes in the order of the machine."""
    words = [bytes.fromhex(address[at : at + 8]) for at in range(0, len(address), 8)]
    return ipaddress.ip_address(b"".join(word[::-1] if sys.byteorder == "little" else word for word in words))


def free_ports(count):
    probes = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [probe.getsockname()[1] for probe in probes]
    for probe in probes:
        probe.close()
    return ports


def answers(port):
    try:
        urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5).close()
    except OSError:
        return False
    return True


@pytest.mark.skipif(sys.platform != "linux", reason="sockets are looked up in /proc")
@pytest.mark.parametrize("address", ["127.0.0.1", "::1", "0.0.0.0", "::"])
def test_what_listens_is_seen_with_its_address(address):
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    program = (
        f"import socket; s = socket.create_server(({address!r}, 0), family={int(family)})\n"
        "print(s.getsockname()[1], flush=True); input()"
    )
    marker = f"DELTASAFE_TEST={os.getpid()} {address}"
    name, _, value = marker.partition("=")
    environment = {**os.environ, name: value}
    with subprocess.Popen(
        [sys.executable, "-c", program], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        port = int(process.stdout.readline())
        assert listening(marker.encode()) == {(ipaddress.ip_address(address), port)}
        process.communicate("\n")


@pytest.mark.skipif(sys.platform != "linux", reason="sockets are looked up in /proc")
def test_it_listens_on_loopback_alone(tmp_path):
    dagster, mlflow = free_ports(2)
    elsewhere = ("DAGSTER_HOME", "MLFLOW_TRACKING_URI", "DELTASAFE_DAGSTER_UI", "DELTASAFE_MLFLOW_UI")
    environment = {name: value for name, value in os.environ.items() if name not in elsewhere}
    environment["DELTASAFE_HOME"] = str(tmp_path)
    command = [sys.executable, "-m", "pipelines.ui", "--port", str(dagster), "--mlflow-port", str(mlflow)]
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=log)
    try:
        while not (answers(dagster) and answers(mlflow)):
            assert process.poll() is None, (tmp_path / "log").read_text()[-4000:]
            time.sleep(0.5)
        found = listening(f"DELTASAFE_HOME={tmp_path}".encode())
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()
    assert {port for _, port in found} >= {dagster, mlflow}
    assert [f"{address}:{port}" for address, port in found if not address.is_loopback] == []
