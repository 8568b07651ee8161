"""From fifty labeled images to a robot that moves safely close to a human hand."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deltasafe.perception.artifact.frozen_ensemble import load_ensemble

__all__ = ["__version__", "load_ensemble"]

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name == "load_ensemble":  # needs torch: planning alone must be importable without it
        from deltasafe.perception.artifact.frozen_ensemble import load_ensemble

        return load_ensemble
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
