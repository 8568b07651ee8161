"""Frozen ensemble: a folder named by the digest of its content, verified before use, loaded without pickle.

manifest.json         format, M, class, preprocessing, network, seeds, digests of data, code and files
member-*.safetensors  weights
calibration.json      calibration of the probabilities on the test images
golden.npz            one image and its prediction
ensemble.onnx         the whole ensemble as one program, for projects that do not install this package
model_card.md         description, evaluation, limits
"""

import pathlib
import shutil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import ArtifactError, DataError, SettingsError
from deltasafe.io.arrays import read_npz
from deltasafe.io.folder_entries import is_clutter
from deltasafe.io.storage import atomic_file, atomic_folder, sha256_of_file, write_json
from deltasafe.perception.artifact.manifest import (
    info_of_manifest,
    load_manifest,
    new_manifest,
    settings_of_manifest,
)
from deltasafe.perception.artifact.model_card import model_card
from deltasafe.perception.artifact.onnx_export import export_onnx
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.perception.inference.backends import InferenceBackend, load_program, select_backend
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.settings import InferenceSettings
from deltasafe.perception.training.member import Member, load_network

_FIRST_WITH_MEMBER_LOGITS = 3
"""Format version; programs of earlier formats lack the output ``member_logits``."""
GOLDEN_TOLERANCE = 1e-4


class FrozenEnsemble(Ensemble):
    """An ensemble loaded from a verified folder.

    A pickle contains the path of the folder, which must exist where the pickle is loaded. It is not verified again.

    Attributes:
        folder: absolute path.
        manifest: content of `manifest.json`.
        calibration: content of `calibration.json`.
        info: what its test images show.
        backend: computes the logits.
    """

    def __init__(
        self, folder: pathlib.Path, manifest: dict[str, Any], device: str = "cpu", backend: str = "auto"
    ) -> None:
        self.folder = folder.absolute()  # the working directory may change before the program is loaded on first use
        self.manifest = manifest
        self.calibration = Calibration.load(folder / "calibration.json")
        self.info = info_of_manifest(folder, manifest)
        network, inference = settings_of_manifest(folder, manifest)
        if self.calibration.n_members != manifest["n_members"]:
            raise ArtifactError(
                folder / "calibration.json",
                f"is of {self.calibration.n_members} members, the ensemble has {manifest['n_members']}; pull it again",
            )
        members = [load_network(network, folder / name) for name in manifest["members"]]
        super().__init__(members, inference, device, self.calibration.temperature)
        self._backend_name = select_backend(backend, self.device)
        if manifest["format_version"] < _FIRST_WITH_MEMBER_LOGITS and self._backend_name != "torch":
            if backend != "auto":
                raise ArtifactError(
                    folder / "ensemble.onnx", f"is of an older format, which {backend} cannot run; use torch"
                )
            self._backend_name = "torch"

    def _create_backend(self) -> InferenceBackend:
        if self._backend_name == "torch":
            return super()._create_backend()
        return load_program(self._backend_name, self.folder / "ensemble.onnx")


def write_frozen_ensemble(
    members: list[Member],
    inference: InferenceSettings,
    calibration: Calibration,
    golden_rgb: NDArray[np.uint8],
    parent: str | pathlib.Path,
    provenance: dict[str, str] | None = None,
    info: DatasetInfo = HANDS,
) -> pathlib.Path:
    """Freeze ``members`` into a subfolder of ``parent`` that is named by the digest of its content.

    The same members, settings and calibration always give the same folder.

    Args:
        members: at least one, all with the same network settings.
        inference: input resolution that ``calibration`` was measured at.
        calibration: of exactly these members.
        golden_rgb: (H, W, 3) uint8, the golden image.
        parent: folder of artifacts.
        provenance: further digests, by name.
        info: what the images of the calibration show.

    Raises:
        SettingsError: no members, members of different networks, or a calibration of another M.
    """
    if not members or any(member.network_settings != members[0].network_settings for member in members):
        raise SettingsError("an ensemble is frozen from at least one member, all of the same network settings")
    if calibration.n_members != len(members):
        raise SettingsError(
            f"the calibration is of {calibration.n_members} members, but {len(members)} are to be frozen"
        )
    ensemble = Ensemble([member.network() for member in members], inference, temperature=calibration.temperature)
    parent = pathlib.Path(parent)
    with atomic_folder(parent / "ensemble", named=artifact_name) as temporary:
        names = [f"member-{index}.safetensors" for index in range(len(members))]
        for member, name in zip(members, names, strict=True):
            shutil.copyfile(member.weights, temporary / name)
        write_json(temporary / "calibration.json", calibration)
        with atomic_file(temporary / "golden.npz") as file:
            np.savez(file, rgb=golden_rgb, p_occupied=ensemble.p_occupied(golden_rgb))
        export_onnx(ensemble, temporary / "ensemble.onnx")
        manifest = new_manifest(members, names, inference, provenance or {}, info)
        with atomic_file(temporary / "model_card.md") as file:
            file.write_text(model_card(manifest, calibration, info), encoding="utf-8")
        manifest["files"] = {path.name: sha256_of_file(path) for path in sorted(temporary.iterdir()) if path.is_file()}
        write_json(temporary / "manifest.json", manifest)
        destination = parent / artifact_name(temporary)
    return destination


def artifact_name(folder: pathlib.Path) -> str:
    """Return the name that the folder must have: a digest of the manifest, which has the digests of all other files."""
    return f"ensemble-{sha256_of_file(folder / 'manifest.json')[:16]}"


def verify_artifact(folder: str | pathlib.Path) -> dict[str, Any]:
    """Check the digest of every file of a frozen ensemble, and return its manifest.

    Raises:
        ArtifactError: a file is missing, altered, of an unknown format, or does not belong to the ensemble.
    """
    folder = pathlib.Path(folder)
    if not folder.is_dir():
        raise ArtifactError(folder, "is not a folder; give the folder of a frozen ensemble")
    manifest = load_manifest(folder)
    expected_name = artifact_name(folder)
    if folder.resolve().name.startswith("ensemble-") and folder.resolve().name != expected_name:
        raise ArtifactError(
            folder,
            f"has another name than its manifest belongs to: rename it to {expected_name} if it was renamed or copied; "
            "otherwise it was altered, pull the artifact again",
        )
    for name, digest in manifest["files"].items():
        file = folder / name
        if not file.is_file():
            raise ArtifactError(file, "is missing; pull the artifact again")
        try:
            altered = sha256_of_file(file) != digest
        except OSError as error:
            raise ArtifactError(file, f"cannot be read ({error.strerror}); restore its permissions") from error
        if altered:
            raise ArtifactError(file, "was altered (its SHA-256 differs); pull the artifact again")
    for file in sorted(folder.iterdir()):
        if file.name not in {"manifest.json", *manifest["files"]}:
            if not is_clutter(file.name):
                raise ArtifactError(file, "does not belong to the ensemble (its manifest does not list it); remove it")
        elif not file.resolve().is_relative_to(folder.resolve()):
            raise ArtifactError(file, "is a link out of the folder; copy the file itself (cp -L)")
    return manifest


def load_ensemble(folder: str | pathlib.Path, device: str = "cpu", backend: str = "auto") -> FrozenEnsemble:
    """Load a frozen ensemble after verifying every file.

    Examples:
        >>> p_occupied = load_ensemble("ensemble-0123456789abcdef").p_occupied(rgb)  # doctest: +SKIP

    Args:
        device: ``cpu``, ``cuda``, ``cuda:1``, ...; ``auto`` is the first CUDA device if there is one, else the CPU.
        backend: ``torch``, ``onnxruntime`` or ``openvino``, whose probabilities differ by at most 1e-4; ``auto`` is
            ONNX Runtime on a CPU if it is installed, else torch.

    Raises:
        ArtifactError: see `verify_artifact`, or the format of the artifact is too old for ``backend``.
        SettingsError: ``device`` is not available, or ``backend`` is unknown, not installed, or does not run on it.
    """
    folder = pathlib.Path(folder)
    return FrozenEnsemble(folder, verify_artifact(folder), device, backend)


def golden_difference(ensemble: FrozenEnsemble) -> float:
    """Return the largest difference in p_occupied between the stored prediction of the golden image and a new one.

    Raises:
        ArtifactError: the difference exceeds `GOLDEN_TOLERANCE`, so this machine does not reproduce the ensemble.
    """
    file = ensemble.folder / "golden.npz"
    try:
        golden = read_npz(file)
        rgb, expected = golden["rgb"], golden["p_occupied"]
        if expected.shape != rgb.shape[:2] or expected.dtype.kind != "f":
            raise ValueError(f"{expected.dtype} {expected.shape} is not a prediction of an image {rgb.shape}")
        predicted = ensemble.p_occupied(rgb)
    except (KeyError, SettingsError, ValueError) as error:
        if isinstance(error, ArtifactError):
            raise
        reason = error.reason if isinstance(error, DataError) else error
        raise ArtifactError(file, f"has no valid image and prediction ({reason}); pull the artifact again") from error
    difference = float(np.abs(predicted - expected).max())
    if not difference <= GOLDEN_TOLERANCE:
        raise ArtifactError(
            file,
            f"is reproduced with a difference of {difference:.2g} in probability, more than {GOLDEN_TOLERANCE}; "
            "use another backend, or pull the artifact again",
        )
    return difference
