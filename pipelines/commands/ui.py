"""`make ui`: the Dagster UI, its daemon and the MLflow UI on the storage of the home; for this machine alone."""

import argparse
import os
import signal
import subprocess
import sys

from deltasafe.compute.processes import stop_session
from pipelines.home import PROJECT, mlflow_ui, prepare_home, tracking_uri
from pipelines.tracking.mlflow_server import mlflow_command, reached_at

__all__ = ["main"]

LOOPBACK = ("127.0.0.1", "localhost")


def main() -> int:
    """Run until interrupted."""
    parser = argparse.ArgumentParser(prog="python -m pipelines.commands.ui", description=__doc__)
    parser.add_argument("--port", type=int, default=3000, help="of the Dagster UI (default 3000)")
    parser.add_argument("--mlflow-port", type=int, default=5000, help="of the MLflow UI (default 5000)")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen at (default: this machine alone)")
    options = parser.parse_args()
    shown = reached_at(options.host)
    if options.host not in LOOPBACK:
        print(f"Listening at {options.host} without a login: whoever reaches it can start and change everything here.")
    root = prepare_home()
    (root / "mlflow").mkdir(exist_ok=True)
    dagster = [sys.executable, "-m", "dagster", "dev", "-w", str(PROJECT / "workspace.yaml")]
    commands = [[*dagster, "-h", options.host, "-p", str(options.port)]]
    os.environ.setdefault("DELTASAFE_DAGSTER_UI", f"http://{shown}:{options.port}")
    if not tracking_uri(root).startswith("http"):
        os.environ.setdefault("DELTASAFE_MLFLOW_UI", f"http://{shown}:{options.mlflow_port}")
        commands.append(mlflow_command(root, options.mlflow_port, options.host))
    print(f"Dagster: {os.environ['DELTASAFE_DAGSTER_UI']}")
    print(f"MLflow:  {mlflow_ui(tracking_uri(root))}/#/experiments?workflowType=machine_learning", flush=True)
    # a shell starts background jobs with SIGINT ignored; children would inherit that, and Dagster stops its own by it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    running = [subprocess.Popen(command, cwd=PROJECT, start_new_session=True) for command in commands]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        running[0].wait()
    except KeyboardInterrupt:
        print("\nStopping ...", flush=True)
    finally:
        for process in running:
            stop_session(process)
    return 0


if __name__ == "__main__":
    sys.exit(main())
