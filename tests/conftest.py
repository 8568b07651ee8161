"""Every test runs with the smoke preset, without telemetry, and with homes of its own."""

import os

os.environ["DELTASAFE_PRESET"] = "smoke"
os.environ["DAGSTER_DISABLE_TELEMETRY"] = "1"
os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"
os.environ["NO_ALBUMENTATIONS_UPDATE"] = "1"
# tests run side by side: threads of one would wait for those of another
os.environ["OMP_NUM_THREADS"] = "1"
os.environ.pop("DELTASAFE_HOME", None)
os.environ.pop("DAGSTER_HOME", None)
