"""The device that networks are trained and run on."""

import torch

from deltasafe.errors import SettingsError


def pick_device(name: str = "auto") -> torch.device:
    """Return the device; ``auto`` is the first CUDA device if there is one, else the CPU.

    Args:
        name: ``auto``, ``cpu``, ``cuda``, ``cuda:1``, ``mps``, ...

    Raises:
        SettingsError: torch does not know the device, or this machine does not have it.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except (RuntimeError, TypeError) as error:
        raise SettingsError(f"device must be auto, cpu, cuda, or another name of torch, got {name!r:.60}") from error
    try:
        torch.empty(1, device=device)
    except (AssertionError, NotImplementedError, RuntimeError) as error:  # the type depends on the build of torch
        reason = str(error).partition("\n")[0][:120]
        raise SettingsError(f"device {name!r} is not available here ({reason}); use cpu or auto") from error
    return device
