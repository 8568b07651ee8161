"""State of an unfinished training as one safetensors file: network, optimiser, losses so far. No pickle."""

import json
import pathlib

import torch
from torch import Tensor, nn

from deltasafe.storage import atomic_file

__all__ = ["Checkpoint"]


class Checkpoint:
    """The last state of one training; it belongs to one ``identity`` (settings, data and seed)."""

    def __init__(self, file: pathlib.Path, identity: str) -> None:
        self.file = file
        self.identity = identity

    def save(self, network: nn.Module, optimiser: torch.optim.Optimizer, losses: list[float]) -> None:
        """Replace the checkpoint, atomically."""
        from safetensors.torch import save_file

        tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
        for index, state in optimiser.state_dict()["state"].items():
            for name, value in state.items():
                tensors[f"optimiser.{index}.{name}"] = torch.as_tensor(value)
        tensors["losses"] = torch.tensor(losses, dtype=torch.float64)
        metadata = {"deltasafe": json.dumps({"identity": self.identity})}
        with atomic_file(self.file) as temporary:
            save_file({key: value.contiguous() for key, value in tensors.items()}, temporary, metadata)

    def restore(self, network: nn.Module, optimiser: torch.optim.Optimizer) -> list[float]:
        """Load the state in place and return the losses so far; empty where there is none that fits."""
        from safetensors import SafetensorError, safe_open

        if not self.file.is_file():
            return []
        try:
            with safe_open(self.file, framework="pt") as opened:
                metadata = json.loads((opened.metadata() or {}).get("deltasafe", "{}"))
                if metadata.get("identity") != self.identity:
                    return []
                tensors = {key: opened.get_tensor(key) for key in opened.keys()}  # noqa: SIM118
        except (SafetensorError, OSError, json.JSONDecodeError):
            return []
        network.load_state_dict(_with_prefix(tensors, "network."))
        state: dict[int, dict[str, Tensor]] = {}
        for key, value in _with_prefix(tensors, "optimiser.").items():
            index, name = key.split(".", 1)
            state.setdefault(int(index), {})[name] = value
        optimiser.load_state_dict({**optimiser.state_dict(), "state": state})
        for parameter, moments in optimiser.state.items():
            # the fused update walks memory, so moments must lie in memory as their parameter does
            for name, value in moments.items():
                if value.shape == parameter.shape:
                    moments[name] = torch.empty_like(parameter).copy_(value)
        losses: list[float] = tensors["losses"].tolist()
        return losses

    def discard(self) -> None:
        self.file.unlink(missing_ok=True)


def _with_prefix(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)}
