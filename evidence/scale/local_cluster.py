"""A Ray cluster on this machine with simulated hosts, for `make scale` and for tests.

Ray listens on all addresses of a machine without a password, and leaves processes behind if its starter is killed. The
cluster therefore runs in a network and PID namespace that is unreachable from outside and ends as a whole. Every host
has a network namespace of its own, connected to the head by a bridge: killing all of its processes simulates the loss
of a machine.
"""

import contextlib
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from types import TracebackType

from deltasafe.compute.processes import descendants, kill_with_descendants
from deltasafe.errors import SettingsError

_INSIDE = "DELTASAFE_IN_NAMESPACES"
_HEAD, _PORT, _ATTEMPTS = "10.78.0.1", 6379, 3
_USER = () if os.geteuid() == 0 else ("--user", "--map-root-user")
_UNSHARE = ("unshare", *_USER, "--net", "--pid", "--fork", "--kill-child", "--mount-proc")


def enter_namespaces(module: str, arguments: Sequence[str]) -> None:
    """Replace this process by ``python -m MODULE`` as PID 1 of new network and PID namespaces; return if it is that.

    All processes that it starts end with it, even if it is killed.

    Raises:
        SettingsError: this user cannot create such namespaces on this system.
    """
    if os.environ.get(_INSIDE) and os.getpid() == 1:
        _ip("link set lo up")
        _ip("link add cluster type bridge")
        _ip(f"addr add {_HEAD}/24 dev cluster")
        _ip("link set cluster up")
        return
    if shutil.which("unshare") is None or not _may_unshare():
        raise SettingsError(
            "network namespaces are needed (Linux with unshare and ip; in a container: the permission to create them)"
        )
    os.environ[_INSIDE] = "1"
    sys.stdout.flush()
    os.execvp(_UNSHARE[0], [*_UNSHARE, sys.executable, "-m", module, *arguments])


class LocalCluster:
    """A head without cores, and hosts with one worker each.

    Attributes:
        address: for `ray.init` in the namespace of the head.

    Args:
        jobs: whether jobs can be submitted, which steps on the cluster need; the dashboard, which starts slowly,
            accepts them.
    """

    address = f"{_HEAD}:{_PORT}"

    def __init__(self, jobs: bool = True) -> None:
        self._jobs = jobs
        self._folder = tempfile.mkdtemp(prefix="ray-", dir="/tmp")  # paths of sockets must be short
        self._hosts: list[tuple[subprocess.Popen[bytes], subprocess.Popen[bytes]]] = []
        self._head: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> "LocalCluster":
        options = ["--head", f"--port={_PORT}", "--num-cpus=0", f"--temp-dir={self._folder}"]
        options += [f"--include-dashboard={str(self._jobs).lower()}", f"--dashboard-host={_HEAD}"]
        try:
            self._head = self._start(_HEAD, options)
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number in range(len(self._hosts)):
            self.kill_host(number)
        if self._head is not None:
            _kill(self._head)
        shutil.rmtree(self._folder, ignore_errors=True)

    def add_host(self, cores: int = 1) -> None:
        """Add a host in its own network namespace."""
        number = len(self._hosts)
        host, address = subprocess.Popen(["unshare", "--net", "sleep", "infinity"]), f"10.78.0.{number + 2}"
        own = _network("self")
        while _network(host.pid) == own:
            time.sleep(0.02)
        _ip(f"link add host{number} type veth peer name eth0 netns {host.pid}")
        _ip(f"link set host{number} master cluster up")
        inside = ["nsenter", "-t", str(host.pid), "-n"]
        for command in ("link set lo up", f"addr add {address}/24 dev eth0", "link set eth0 up"):
            subprocess.run([*inside, "ip", *command.split()], check=True)
        self._hosts.append((host, host))
        worker = self._start(address, [f"--address={self.address}", f"--num-cpus={cores}"], inside)
        self._hosts[number] = host, worker

    def kill_host(self, number: int) -> None:
        """SIGKILL all processes of a host."""
        host, worker = self._hosts[number]
        _kill(worker)
        _kill(host)

    def kill_a_worker(self) -> bool:
        """SIGKILL one worker process that runs a task; False if there is none."""
        for pid in self.busy_pids():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
                return True
        return False

    def busy_pids(self) -> list[int]:
        """Return the PIDs of the worker processes that run a task of `deltasafe.compute.ray_executor`."""
        found = []
        for pid in [pid for _, worker in self._hosts for pid in descendants(worker.pid)]:
            with contextlib.suppress(OSError):
                if pathlib.Path(f"/proc/{pid}/cmdline").read_bytes().startswith(b"ray::deltasafe"):
                    found.append(pid)
        return found

    def _start(self, address: str, options: Sequence[str], inside: Sequence[str] = ()) -> "subprocess.Popen[bytes]":
        """Start a part of the cluster and wait until it runs; on a loaded machine, some attempts fail."""
        ray = str(pathlib.Path(sys.executable).with_name("ray"))
        command = [*inside, ray, "start", "--block", "--disable-usage-stats", f"--node-ip-address={address}", *options]
        for _ in range(_ATTEMPTS):
            with tempfile.TemporaryFile() as output:
                process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
                while process.poll() is None:
                    if b"Ray runtime started" in os.pread(output.fileno(), 1 << 20, 0):
                        return process
                    if self._head is not None and self._head.poll() is not None:
                        raise RuntimeError(f"the head of the cluster exited with {self._head.returncode}")
                    time.sleep(0.2)
                reason = os.pread(output.fileno(), 1 << 20, 0).decode(errors="replace")
            _kill(process)
        raise RuntimeError(f"a part of the cluster did not start:\n{reason}")


def _may_unshare() -> bool:
    return subprocess.run([*_UNSHARE, "ip", "link"], check=False, capture_output=True).returncode == 0


def _network(process: int | str) -> str:
    return str(pathlib.Path(f"/proc/{process}/ns/net").readlink())


def _ip(command: str) -> None:
    subprocess.run(["ip", *command.split()], check=True)


def _kill(process: "subprocess.Popen[bytes]") -> None:
    """SIGKILL a process that we started and all its descendants."""
    kill_with_descendants(process.pid)
    process.wait()
