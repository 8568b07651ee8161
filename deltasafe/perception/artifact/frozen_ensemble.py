"""The frozen ensemble: a folder named by its content, verified before it is used, loaded without pickle.

manifest.json         format, M, class, preprocessing, network, seeds, digests of data, code and files
member-*.safetensors  weights
calibration.json      what the test images say about its probabilities
golden.npz            one image and the answer that it must give
ensemble.onnx         the whole ensemble as one program, for projects that do not install this package
model_card.md         what it is, how it was judged, where it fails
"""

import dataclasses
import pathlib
import shutil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.code_digest import digest_of_package
from deltasafe.errors import ArtifactError, DataError, SettingsError
from deltasafe.io.arrays import read_npz
from deltasafe.io.storage import atomic_file, atomic_folder, sha256_of_file, write_json
from deltasafe.perception.artifact.manifest import FORMAT_VERSION, described, read_manifest
from deltasafe.perception.artifact.model_card import model_card
from deltasafe.perception.artifact.onnx_export import export_onnx
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.inference.backends import InferenceBackend, backend_of_program, select_backend
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.settings import InferenceSettings
from deltasafe.perception.training.member import Member, load_network

__all__ = [
    "FORMAT_VERSION",
    "FrozenEnsemble",
    "artifact_name",
    "golden_difference",
    "load_ensemble",
    "verify_artifact",
    "write_frozen_ensemble",
]

_FIRST_WITH_ANY_SIZE = 3
GOLDEN_TOLERANCE = 1e-4


class FrozenEnsemble(Ensemble):
    """An ensemble that was loaded from a verified folder.

    A pickle names the folder, which must be readable where the pickle is loaded; it is not verified again.

    Attributes:
        folder: where it lies, absolute.
        manifest: content of `manifest.json`.
        calibration: what the test images say about it.
        backend: what computes the logits; its ``name`` says which.
    """

    def __init__(
        self, folder: pathlib.Path, manifest: dict[str, Any], device: str = "cpu", backend: str = "auto"
    ) -> None:
        self.folder = folder.absolute()  # the program is read on first use, when the working directory may be another
        self.manifest = manifest
        self.calibration = Calibration.load(folder / "calibration.json")
        network, inference = described(folder, manifest)
        if self.calibration.n_members != manifest["n_members"]:
            raise ArtifactError(
                folder / "calibration.json",
                f"is of {self.calibration.n_members} members, the ensemble has {manifest['n_members']}; pull it again",
            )
        members = [load_network(network, folder / name) for name in manifest["members"]]
        super().__init__(members, inference, device, self.calibration.temperature)
        self._backend_name = select_backend(backend, self.device)
        if manifest["format_version"] < _FIRST_WITH_ANY_SIZE and self._backend_name != "torch":
            if backend != "auto":
                raise ArtifactError(
                    folder / "ensemble.onnx", f"is of an older format, which {backend} does not run here; use torch"
                )
            self._backend_name = "torch"

    def _create_engine(self) -> InferenceBackend:
        if self._backend_name == "torch":
            return super()._create_engine()
        return backend_of_program(self._backend_name, self.folder / "ensemble.onnx")


def write_frozen_ensemble(
    members: list[Member],
    inference: InferenceSettings,
    calibration: Calibration,
    golden_rgb: NDArray[np.uint8],
    parent: str | pathlib.Path,
    provenance: dict[str, str] | None = None,
) -> pathlib.Path:
    """Write the ensemble of ``members`` to a folder below ``parent`` that is named by its content.

    Freezing the same members, settings and calibration twice gives the same folder.

    Args:
        members: at least one, all of one network.
        inference: the resolution that ``calibration`` was measured at.
        calibration: of exactly these members.
        golden_rgb: (H, W, 3) uint8, an image whose answer is stored beside it.
        parent: folder of artifacts.
        provenance: digests of data and code, name -> digest.

    Raises:
        SettingsError: no members, or members of different networks, or a calibration of another M.
    """
    if not members or any(member.network_settings != members[0].network_settings for member in members):
        raise SettingsError("an ensemble is frozen from at least one member, all of the same network settings")
    if calibration.n_members != len(members):
        raise SettingsError(
            f"the calibration is of {calibration.n_members} members, but {len(members)} are to be frozen"
        )
    networks = [member.network() for member in members]
    ensemble = Ensemble(networks, inference, temperature=calibration.temperature)
    parent = pathlib.Path(parent)
    with atomic_folder(parent / "ensemble", named=artifact_name) as temporary:
        names = [f"member-{index}.safetensors" for index in range(len(members))]
        for member, name in zip(members, names, strict=True):
            shutil.copyfile(member.weights, temporary / name)
        write_json(temporary / "calibration.json", calibration)
        with atomic_file(temporary / "golden.npz") as file:
            np.savez(file, rgb=golden_rgb, p_occupied=ensemble.p_occupied(golden_rgb))
        export_onnx(ensemble, temporary / "ensemble.onnx")
        manifest = {
            "format_version": FORMAT_VERSION,
            "n_members": len(members),
            "members": names,
            "seeds": [member.seed for member in members],
            "class": "p_occupied: probability that a pixel shows a hand or forearm (masks: 255 = hand)",
            "preprocessing": "RGB uint8; scaled to the inference size (area or bilinear); ImageNet statistics "
            "are applied inside the network",
            "network": dataclasses.asdict(members[0].network_settings),
            "inference": dataclasses.asdict(inference),
            "provenance": {
                "data": members[0].record["data_digest"],
                "code": digest_of_package(),
                **(provenance or {}),
            },
        }
        with atomic_file(temporary / "model_card.md") as file:
            file.write_text(model_card(manifest, calibration), encoding="utf-8")
        manifest["files"] = {path.name: sha256_of_file(path) for path in sorted(temporary.iterdir()) if path.is_file()}
        write_json(temporary / "manifest.json", manifest)
        destination = parent / artifact_name(temporary)
    return destination


def artifact_name(folder: pathlib.Path) -> str:
    """What the folder of a frozen ensemble must be called: by its manifest, which names the digests of all else."""
    return f"ensemble-{sha256_of_file(folder / 'manifest.json')[:16]}"


def verify_artifact(folder: str | pathlib.Path) -> dict[str, Any]:
    """Check that a frozen ensemble is complete and unaltered; returns its manifest.

    Raises:
        ArtifactError: names the file that is missing, altered, or of an unknown format.
    """
    folder = pathlib.Path(folder)
    if not folder.is_dir():
        raise ArtifactError(folder, "is not a folder; give the folder of a frozen ensemble")
    manifest = read_manifest(folder)
    expected_name = artifact_name(folder)
    if folder.resolve().name.startswith("ensemble-") and folder.resolve().name != expected_name:
        raise ArtifactError(folder, f"was altered: its manifest belongs to {expected_name}; pull the artifact again")
    for name, digest in manifest["files"].items():
        file = folder / name
        if not file.is_file():
            raise ArtifactError(file, "is missing; pull the artifact again")
        try:
            found = sha256_of_file(file)
        except OSError as error:
            raise ArtifactError(file, f"cannot be read ({error.strerror}); restore its permissions") from error
        if found != digest:
            raise ArtifactError(file, "was altered (its SHA-256 differs); pull the artifact again")
    for file in sorted(folder.iterdir()):
        if file.name not in {"manifest.json", *manifest["files"]}:
            if not file.name.startswith("."):  # hidden ones are left by desktops, and read by nobody
                raise ArtifactError(file, "does not belong to the ensemble (its manifest does not name it); remove it")
        elif not file.resolve().is_relative_to(folder.resolve()):
            raise ArtifactError(file, "is a link out of the folder; copy the file itself (cp -L)")
    return manifest


def load_ensemble(folder: str | pathlib.Path, device: str = "cpu", backend: str = "auto") -> FrozenEnsemble:
    """Load a frozen ensemble after verifying every file of it.

    Examples:
        >>> p_occupied = load_ensemble("ensemble-0123456789abcdef").p_occupied(rgb)  # doctest: +SKIP

    Args:
        device: ``cpu``, ``cuda``, ...
        backend: ``torch``, ``onnxruntime`` or ``openvino``, which agree to 1e-4 in probability; ``auto`` is ONNX
            Runtime where it is installed and the device is a CPU.

    Raises:
        ArtifactError: see `verify_artifact`, or the artifact's format is too old for ``backend``.
        SettingsError: ``backend`` is unknown, not installed, or none for ``device``.
    """
    folder = pathlib.Path(folder)
    return FrozenEnsemble(folder, verify_artifact(folder), device, backend)


def golden_difference(ensemble: FrozenEnsemble) -> float:
    """Largest difference in p_occupied between the stored answer to the golden image and the one given now.

    Raises:
        ArtifactError: it exceeds the tolerance: this machine does not reproduce the ensemble.
    """
    file = ensemble.folder / "golden.npz"
    try:
        golden = read_npz(file)
        rgb, expected = golden["rgb"], golden["p_occupied"]
        if expected.shape != rgb.shape[:2] or expected.dtype.kind != "f":
            raise ValueError(f"{expected.dtype} {expected.shape} is no answer to an image {rgb.shape}")
        answered = ensemble.p_occupied(rgb)
    except (KeyError, SettingsError, ValueError) as error:
        if isinstance(error, ArtifactError):
            raise
        reason = error.reason if isinstance(error, DataError) else error
        raise ArtifactError(file, f"holds no image and answer ({reason}); pull the artifact again") from error
    difference = float(np.abs(answered - expected).max())
    if not difference <= GOLDEN_TOLERANCE:
        raise ArtifactError(
            file,
            f"is answered with a difference of {difference:.2g} in probability (<= {GOLDEN_TOLERANCE}); "
            "use another backend, or pull the artifact again",
        )
    return difference
