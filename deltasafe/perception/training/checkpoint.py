"""Checkpoint of an unfinished training as one safetensors file: network, optimizer state and losses. No pickle."""

import json
import pathlib

import torch
from torch import Tensor, nn

from deltasafe.io.storage import atomic_file, parse_json


class Checkpoint:
    """The latest state of one training.

    Args:
        file: path of the safetensors file.
        identity: digest of settings, data and seed; a file with another identity is ignored.
    """

    def __init__(self, file: pathlib.Path, identity: str) -> None:
        self.file = file
        self.identity = identity

    def save(self, network: nn.Module, optimizer: torch.optim.Optimizer, losses: list[float]) -> None:
        """Replace the file atomically."""
        from safetensors.torch import save_file

        tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
        for index, state in optimizer.state_dict()["state"].items():
            for name, value in state.items():
                tensors[f"optimizer.{index}.{name}"] = torch.as_tensor(value)
        tensors["losses"] = torch.tensor(losses, dtype=torch.float64)
        metadata = {"deltasafe": json.dumps({"identity": self.identity})}
        with atomic_file(self.file) as temporary:
            save_file({key: value.contiguous() for key, value in tensors.items()}, temporary, metadata)

    def restore(self, network: nn.Module, optimizer: torch.optim.Optimizer) -> list[float]:
        """Load the state in place and return the losses so far.

        If the file is missing, damaged, or of another training, nothing changes and the list is empty.
        """
        tensors = self._read()
        weights, state = _with_prefix(tensors, "network."), _by_parameter(_with_prefix(tensors, "optimizer."))
        if state is None or "losses" not in tensors or _shapes(weights) != _shapes(network.state_dict()):
            return []
        network.load_state_dict(weights)
        optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
        for parameter, moments in optimizer.state.items():
            # the fused update assumes that moments have the memory layout of their parameter (channels last)
            for name, value in moments.items():
                if value.shape == parameter.shape:
                    moments[name] = torch.empty_like(parameter).copy_(value)
        losses: list[float] = tensors["losses"].tolist()
        return losses

    def discard(self) -> None:
        """Remove the file, if there is one."""
        self.file.unlink(missing_ok=True)

    def _read(self) -> dict[str, Tensor]:
        """Return all tensors; none if the file is missing, damaged, of another identity, or has non-finite values."""
        from safetensors import SafetensorError, safe_open

        if not self.file.is_file():
            return {}
        try:
            with safe_open(self.file, framework="pt") as opened:
                metadata = parse_json((opened.metadata() or {}).get("deltasafe", "{}"))
                if not isinstance(metadata, dict) or metadata.get("identity") != self.identity:
                    return {}
                tensors = {key: opened.get_tensor(key) for key in opened.keys()}  # noqa: SIM118
        except (SafetensorError, OSError, ValueError):
            return {}
        return tensors if all(bool(value.isfinite().all()) for value in tensors.values()) else {}


def _by_parameter(tensors: dict[str, Tensor]) -> dict[int, dict[str, Tensor]] | None:
    """Group optimizer tensors named ``INDEX.NAME`` by parameter index; None if a name has another form."""
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        index, _, name = key.partition(".")
        if not index.isdecimal() or not name:
            return None
        state.setdefault(int(index), {})[name] = value
    return state


def _shapes(tensors: dict[str, Tensor]) -> dict[str, tuple[int, ...]]:
    return {key: tuple(value.shape) for key, value in tensors.items()}


def _with_prefix(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)}
