"""Find the frozen folder of a registered version, or download it from MLflow."""

import pathlib
import re
import shutil
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_folder
from pipelines.addresses import masked
from pipelines.home import tracking_uri
from pipelines.tracking.tracker import is_reachable


def frozen_folder(version: Any, home: pathlib.Path) -> pathlib.Path:
    """Return the frozen folder of a version; if it is missing here, download and verify it.

    Raises:
        DataError: another project registered the version, or its artifact is missing or damaged.
    """
    import mlflow

    from deltasafe.perception.artifact.frozen_ensemble import artifact_name, verify_artifact

    name = version.tags.get("artifact", "")
    folder = home / "frozen" / name
    if not re.fullmatch(r"ensemble-[0-9a-f]{16}", name):
        raise DataError(f"version {version.version}", f"was not registered by this project (tag artifact: {name!r})")
    if not folder.is_dir():
        with atomic_folder(folder) as temporary:
            download = temporary / "download"  # without dst_path, a registry in files returns its own files
            download.mkdir()
            artifact = f"models:/{version.name}/{version.version}/artifacts/{name}"
            try:
                fetched = mlflow.artifacts.download_artifacts(artifact, dst_path=str(download))
            except (mlflow.MlflowException, OSError) as error:
                reason = masked(error)
                if not is_reachable(tracking_uri(home)):
                    raise ConnectionError(reason) from None
                raise DataError(
                    folder, f"is missing, and so is its copy in MLflow ({reason}); freeze it again, or use another one"
                ) from None
            for path in pathlib.Path(fetched).iterdir():
                path.replace(temporary / path.name)
            shutil.rmtree(download)
            verify_artifact(temporary)
            if artifact_name(temporary) != name:
                raise DataError(f"version {version.version}", f"contains {artifact_name(temporary)}, not {name}")
    return folder
