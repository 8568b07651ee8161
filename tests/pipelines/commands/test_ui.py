"""`make ui` listens on loopback addresses only."""

import ipaddress
import os
import pathlib
import socket
import subprocess
import sys
import urllib.parse

import pytest

from tests.loopback import serve

LISTEN = "0A"


def listening(marker):
    """Return the TCP addresses and ports on which processes with ``marker`` in their environment listen."""
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
            if state == LISTEN and f"socket:[{inode}]" in sockets:
                address, port = local.split(":")
                found.add((parsed(address), int(port, 16)))
    return found


def parsed(address):
    """Parse an address of /proc/net: words of four bytes in native byte order."""
    words = [bytes.fromhex(address[at : at + 8]) for at in range(0, len(address), 8)]
    return ipaddress.ip_address(b"".join(word[::-1] if sys.byteorder == "little" else word for word in words))


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
@pytest.mark.parametrize("address", ["127.0.0.1", "::1", "0.0.0.0", "::"])
def test_listening_sockets_are_found_with_their_address(address):
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


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_all_servers_listen_on_loopback(tmp_path):
    with serve(tmp_path, "smoke", tmp_path / "log") as addresses:
        found = listening(f"DELTASAFE_HOME={tmp_path}".encode())
    assert {port for _, port in found} >= {urllib.parse.urlsplit(address).port for address in addresses}
    assert [f"{address}:{port}" for address, port in found if not address.is_loopback] == []
