"""`make ui`: start the Dagster UI, its daemon and the MLflow UI for the home. They listen on this machine only."""

import argparse
import errno
import os
import signal
import socket
import subprocess
import sys

from deltasafe.compute.interrupts import interrupts_delayed
from deltasafe.compute.processes import stop_session
from deltasafe.errors import SettingsError
from deltasafe.io.locks import FileLock
from pipelines.command_line import run_command
from pipelines.home import PROJECT, mlflow_ui, prepare_home, tracking_uri
from pipelines.tracking.mlflow_server import allow_names, local_address, mlflow_command

POOLS = ("all_cores", "registry")
LOOPBACK = ("127.0.0.1", "localhost")
_STOP = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main(arguments: list[str] | None = None) -> int:
    """Run the servers until interrupted; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m pipelines.commands.ui", description=__doc__)
    parser.add_argument("--port", type=int, default=3000, help="port of the Dagster UI (default 3000)")
    parser.add_argument("--mlflow-port", type=int, default=5000, help="port of the MLflow UI (default 5000)")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    options = parser.parse_args(arguments)
    return run_command(lambda: _run(options))


def _run(options: argparse.Namespace) -> int:
    root = prepare_home()
    _check_dagster()
    (root / "mlflow").mkdir(exist_ok=True)
    shown = local_address(options.host)
    dagster = [sys.executable, "-m", "dagster", "dev", "-w", str(PROJECT / "workspace.yaml")]
    commands = [[*dagster, "-h", options.host, "-p", str(options.port)]]
    _check_port(options.host, options.port, "--port")
    os.environ.setdefault("DELTASAFE_DAGSTER_UI", f"http://{shown}:{options.port}")
    if not tracking_uri(root).startswith("http"):
        _check_port(options.host, options.mlflow_port, "--mlflow-port")
        os.environ.setdefault("DELTASAFE_MLFLOW_UI", f"http://{shown}:{options.mlflow_port}")
        if options.host not in LOOPBACK:
            allow_names(options.host, os.environ["DELTASAFE_MLFLOW_UI"])
        commands.append(mlflow_command(root, options.mlflow_port, options.host))
    with FileLock(root / "ui.lock", timeout_s=0.0):  # a second daemon would start runs twice
        if options.host not in LOOPBACK:
            print(f"Listening on {options.host} without a login: anyone with access can start and change everything.")
        print(f"Dagster: {os.environ['DELTASAFE_DAGSTER_UI']}")
        print(f"MLflow:  {mlflow_ui(tracking_uri(root))}/#/experiments?workflowType=machine_learning", flush=True)
        return _serve(commands)


def _serve(commands: list[list[str]]) -> int:
    """Run the servers until the first one ends or this process is interrupted; return the exit status."""
    # a shell starts background jobs with SIGINT ignored; Dagster would inherit that, and stops its children by SIGINT
    for number in _STOP:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores it
            signal.signal(number, _stop)
    servers: list[subprocess.Popen] = []
    try:
        for command in commands:
            with interrupts_delayed():
                servers.append(subprocess.Popen(command, cwd=PROJECT, start_new_session=True))
        return 0 if servers[0].wait() == 0 else 1
    except KeyboardInterrupt:
        print("\nStopping ...", flush=True)
        return 0
    finally:
        for server in servers:
            stop_session(server)


def _stop(*_: object) -> None:
    """Interrupt once: further signals are ignored, so that they cannot end the clean-up between two servers."""
    for number in _STOP:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _check_dagster() -> None:
    """Open Dagster's instance: errors in `dagster.yaml` or its database are reported before any server starts.

    It also creates the pools, which the UI otherwise shows only after a run has used them.
    """
    import dagster as dg

    with dg.DagsterInstance.get() as instance:
        known = {limit.name for limit in instance.event_log_storage.get_pool_limits()}
        for pool in {*POOLS} - known:
            instance.event_log_storage.initialize_concurrency_limit_to_default(pool)


def _check_port(host: str, port: int, option: str) -> None:
    """Raise SettingsError if a server cannot listen on a port: it is in use, or permission is missing."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as client:
            if client.connect_ex(address) == 0:  # on macOS, bind succeeds beside a server on all addresses
                raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE))
        with socket.socket(family, kind, protocol) as server:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            server.bind(address)
    except OSError as error:
        raise SettingsError(f"cannot listen on {host}:{port} ({error.strerror}); choose another {option}") from error


if __name__ == "__main__":
    sys.exit(main())
