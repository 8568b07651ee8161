"""State of an unfinished training as one safetensors file: network, optimizer, losses so far. No pickle."""

import json
import pathlib

import torch
from torch import Tensor, nn

from deltasafe.io.storage import atomic_file, parse_json

__all__ = ["Checkpoint"]


class Checkpoint:
    """The last state of one training; it belongs to one ``identity`` (settings, data and seed)."""

    def __init__(self, file: pathlib.Path, identity: str) -> None:
        self.file = file
        self.identity = identity

    def save(self, network: nn.Module, optimizer: torch.optim.Optimizer, losses: list[float]) -> None:
        """Replace the checkpoint, atomically."""
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
        """Load the state in place and return the losses so far; empty where there is none that fits.

        A damaged checkpoint is none: it changes nothing, and the training begins anew.
        """
        tensors = self._intact()
        weights, state = _with_prefix(tensors, "network."), _by_parameter(_with_prefix(tensors, "optimizer."))
        if state is None or "losses" not in tensors or _shapes(weights) != _shapes(network.state_dict()):
            return []
        network.load_state_dict(weights)
        optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
        for parameter, moments in optimizer.state.items():
            # the fused update walks memory, so moments must lie in memory as their parameter does
            for name, value in moments.items():
                if value.shape == parameter.shape:
                    moments[name] = torch.empty_like(parameter).copy_(value)
        losses: list[float] = tensors["losses"].tolist()
        return losses

    def _intact(self) -> dict[str, Tensor]:
        """All tensors of the file; none if it is damaged, of another training, or has weights that are not finite."""
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

    def discard(self) -> None:
        self.file.unlink(missing_ok=True)


def _by_parameter(tensors: dict[str, Tensor]) -> dict[int, dict[str, Tensor]] | None:
    """The optimizer's state by the number of the parameter; None if a name has none."""
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
