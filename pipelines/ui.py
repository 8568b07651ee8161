"""`make ui`: the Dagster UI, its daemon and the MLflow UI on the storage of the home; loopback only."""

import argparse
import contextlib
import os
import signal
import subprocess
import sys

from pipelines.home import PROJECT, mlflow_ui, prepare_home, tracking_uri

__all__ = ["main"]


def main() -> int:
    """Run until interrupted."""
    parser = argparse.ArgumentParser(prog="python -m pipelines.ui", description=__doc__)
    parser.add_argument("--port", type=int, default=3000, help="of the Dagster UI (default 3000)")
    parser.add_argument("--mlflow-port", type=int, default=5000, help="of the MLflow UI (default 5000)")
    options = parser.parse_args()
    root = prepare_home()
    (root / "mlflow").mkdir(exist_ok=True)
    dagster = [sys.executable, "-m", "dagster", "dev", "-w", str(PROJECT / "workspace.yaml")]
    commands = [[*dagster, "-h", "127.0.0.1", "-p", str(options.port)]]
    os.environ.setdefault("DELTASAFE_DAGSTER_UI", f"http://127.0.0.1:{options.port}")
    if not tracking_uri(root).startswith("http"):
        os.environ.setdefault("DELTASAFE_MLFLOW_UI", f"http://127.0.0.1:{options.mlflow_port}")
        mlflow = [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", tracking_uri(root)]
        commands.append([*mlflow, "--host", "127.0.0.1", "--port", str(options.mlflow_port)])
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
        dagster_ui, *others = running
        dagster_ui.terminate()  # the leader alone: it stops its children in order, and hangs if they die first
        for other in others:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(other.pid, signal.SIGTERM)  # the whole group: its leader passes nothing on
        for process in running:
            try:
                process.wait(timeout=30)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
    return 0


if __name__ == "__main__":
    sys.exit(main())
