"""Predict with the ensemble in use, from the MLflow registry by its alias.

python from_registry.py IMAGE [--registry http://host:5000] [-o p_occupied.npy]
"""

import argparse
import os
import sys

import mlflow
import numpy as np
from mlflow.exceptions import MlflowException

from deltasafe import ArtifactError, DeltasafeError, load_ensemble, perception


def load_from_registry(name: str, alias: str, folder: str | None = None) -> perception.FrozenEnsemble:
    """Download and verify the ensemble `models:/NAME@ALIAS`.

    Only the frozen folder of the model is downloaded, and no code of the registry is executed. The content must equal
    the one that was registered under this version.

    Raises:
        ArtifactError: a file is missing or altered, or belongs to another ensemble than the registered one.
        MlflowException: the registry has no such model or alias, or is unreachable.
    """
    version = mlflow.MlflowClient().get_model_version_by_alias(name, alias)
    registered = version.tags.get("artifact")
    if registered is None:
        raise ArtifactError(f"models:/{name}@{alias}", "has no tag `artifact`; it was not registered by deltasafe")
    model = f"models:/{name}/{version.version}"  # not the alias, which may move during the download
    downloaded = mlflow.artifacts.download_artifacts(f"{model}/artifacts/{registered}", dst_path=folder)
    return load_ensemble(downloaded)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("image", help="PNG or JPEG of any size")
    parser.add_argument("--registry", help="URL of a server, or sqlite:///FILE (default: $MLFLOW_TRACKING_URI)")
    parser.add_argument("--name", default="deltasafe-hand-ensemble", help="registered model (default: %(default)s)")
    parser.add_argument("--alias", default="champion", help="(default: %(default)s)")
    parser.add_argument("-o", "--output", default="p_occupied.npy", help="(H, W) float32 (default: %(default)s)")
    options = parser.parse_args()
    if options.registry:
        mlflow.set_tracking_uri(options.registry)

    ensemble = load_from_registry(options.name, options.alias)
    difference = perception.golden_difference(ensemble)
    p_occupied = ensemble.p_occupied(perception.read_rgb(options.image))

    np.save(options.output, p_occupied)
    print(f"{options.name}@{options.alias} is {ensemble.folder.name}: intact, golden image within {difference:.0e}")
    print(f"p_occupied > 0.05 on {(p_occupied > 0.05).mean():.1%} of {options.image}")


if __name__ == "__main__":
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    try:
        main()
    except (DeltasafeError, MlflowException) as error:
        sys.exit(f"from_registry: {error}")
