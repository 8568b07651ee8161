"""One trained member on disk: a folder with `weights.safetensors` and `member.json`."""

import dataclasses
import pathlib
from typing import Any

from torch import nn

from deltasafe.errors import ArtifactError, DataError
from deltasafe.io.storage import atomic_file, read_json, sha256_of_file, write_json
from deltasafe.perception.settings import NetworkSettings
from deltasafe.perception.training.network import SegmentationNetwork, build_network

__all__ = ["Member"]


@dataclasses.dataclass(frozen=True)
class Member:
    """A finished member.

    Attributes:
        folder: where it lies.
        record: content of `member.json`: identity (digest of settings, data and seed), seed, settings, losses
            a step, digest of the data and of the weights.
    """

    folder: pathlib.Path
    record: dict[str, Any]

    @classmethod
    def write(cls, folder: pathlib.Path, network: nn.Module, record: dict[str, Any]) -> "Member":
        """Write weights, then the record that makes them a member."""
        from safetensors.torch import save_file

        with atomic_file(folder / "weights.safetensors") as temporary:
            save_file({key: value.cpu().contiguous() for key, value in network.state_dict().items()}, temporary)
        record = {**record, "weights_sha256": sha256_of_file(folder / "weights.safetensors")}
        write_json(folder / "member.json", record)
        return cls(folder, read_json(folder / "member.json"))

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "Member":
        """Read a member and verify its weights against the record.

        Raises:
            DataError: a file is missing or malformed.
            ArtifactError: the weights are not those that were recorded.
        """
        folder = pathlib.Path(folder)
        record = read_json(folder / "member.json")
        weights = folder / "weights.safetensors"
        if not isinstance(record, dict) or not isinstance(record.get("weights_sha256"), str):
            raise DataError(folder / "member.json", "names no digest of the weights; train the member again")
        if not weights.is_file():
            raise DataError(weights, "is missing; train the member again")
        try:
            found = sha256_of_file(weights)
        except OSError as error:
            raise DataError(weights, f"cannot be read ({error.strerror}); restore its permissions") from error
        if found != record["weights_sha256"]:
            raise ArtifactError(weights, "differs from the digest in member.json; train the member again")
        return cls(folder, record)

    @classmethod
    def find(cls, folder: pathlib.Path, identity: str) -> "Member | None":
        """The finished, intact member of that identity in ``folder``, if there is one."""
        try:
            member = cls.load(folder)
        except (DataError, KeyError):
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
        """Shared by all members that were trained alike on the same data."""
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
                self.folder / "member.json", f"describes no network ({error!r}); train the member again"
            ) from error

    def network(self) -> SegmentationNetwork:
        """The trained network in evaluation mode, on the CPU."""
        return load_network(self.network_settings, self.weights)


def load_network(settings: NetworkSettings, weights: pathlib.Path) -> SegmentationNetwork:
    """A network with the weights of a safetensors file, in evaluation mode.

    Raises:
        ArtifactError: the weights do not fit the settings, or one of them is NaN or infinite.
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
            weights,
            f"does not hold the weights of {settings} ({reason}); pull the artifact, or train the member, again",
        ) from error
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not bool(tensor.isfinite().all()):
            raise ArtifactError(weights, f"holds a value in {name} that is not finite; train the member again")
    return network.eval()
