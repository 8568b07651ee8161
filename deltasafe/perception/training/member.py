"""One trained member on disk: a folder with `weights.safetensors` and `member.json`."""

import dataclasses
import pathlib
from typing import Any

from torch import nn

from deltasafe.errors import ArtifactError, DataError
from deltasafe.io.storage import atomic_file, read_json, sha256_of_file, write_json
from deltasafe.perception.settings import NetworkSettings
from deltasafe.perception.training.network import SegmentationNetwork, build_network


@dataclasses.dataclass(frozen=True)
class Member:
    """A trained member.

    Attributes:
        folder: the member's folder.
        record: content of `member.json`: identity (digest of settings, data and seed), seed, settings, loss of each
            step, digests of data and weights.
    """

    folder: pathlib.Path
    record: dict[str, Any]

    @classmethod
    def write(cls, folder: pathlib.Path, network: nn.Module, record: dict[str, Any]) -> "Member":
        """Write the weights first, then the record: a folder without a record is not a member."""
        from safetensors.torch import save_file

        with atomic_file(folder / "weights.safetensors") as temporary:
            save_file({key: value.cpu().contiguous() for key, value in network.state_dict().items()}, temporary)
        record = {**record, "weights_sha256": sha256_of_file(folder / "weights.safetensors")}
        write_json(folder / "member.json", record)
        return cls(folder, read_json(folder / "member.json"))

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "Member":
        """Read a member and compare its weights with the recorded digest.

        Raises:
            DataError: a file is missing or malformed.
            ArtifactError: the digest of the weights differs from the record.
        """
        folder = pathlib.Path(folder)
        record = read_json(folder / "member.json")
        weights = folder / "weights.safetensors"
        if not isinstance(record, dict) or not isinstance(record.get("weights_sha256"), str):
            raise DataError(folder / "member.json", "has no digest of the weights; train the member again")
        if not weights.is_file():
            raise DataError(weights, "is missing; train the member again")
        try:
            digest = sha256_of_file(weights)
        except OSError as error:
            raise DataError(weights, f"cannot be read ({error.strerror}); restore its permissions") from error
        if digest != record["weights_sha256"]:
            raise ArtifactError(weights, "differs from the digest in member.json; train the member again")
        return cls(folder, record)

    @classmethod
    def find(cls, folder: pathlib.Path, identity: str) -> "Member | None":
        """Return the intact member of ``folder`` if it has this identity, else None."""
        try:
            member = cls.load(folder)
        except DataError:
            return None
        return member if member.record.get("identity") == identity else None

    @property
    def weights(self) -> pathlib.Path:
        return self.folder / "weights.safetensors"

    @property
    def seed(self) -> int:
        return int(self.record["seed"])

    @property
    def ensemble_identity(self) -> str:
        """Digest of settings and data without the seed: equal for all members of an ensemble."""
        return str(self.record["ensemble_identity"])

    @property
    def losses(self) -> list[float]:
        return [float(value) for value in self.record["losses"]]

    @property
    def network_settings(self) -> NetworkSettings:
        try:
            return NetworkSettings.from_record(self.record["settings"]["network"])
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(
                self.folder / "member.json", f"has no valid network settings ({error!r}); train the member again"
            ) from error

    def network(self) -> SegmentationNetwork:
        """Load the network, in evaluation mode on the CPU."""
        return load_network(self.network_settings, self.weights)


def load_network(settings: NetworkSettings, weights: pathlib.Path) -> SegmentationNetwork:
    """Build a network with the weights of a safetensors file, in evaluation mode on the CPU.

    Raises:
        ArtifactError: the weights do not fit the settings, or a value is NaN or infinite.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    network = build_network(dataclasses.replace(settings, pretrained=False), seed=0)
    try:
        tensors = load_file(weights)
        network.load_state_dict(tensors)
    except (SafetensorError, OSError, RuntimeError, ValueError, KeyError, TypeError, MemoryError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ArtifactError(
            weights, f"does not hold the weights of {settings} ({reason}); pull the artifact or train the member again"
        ) from error
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not bool(tensor.isfinite().all()):
            raise ArtifactError(weights, f"has a non-finite value in {name}; train the member again")
    return network.eval()
