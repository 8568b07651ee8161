"""Mitsuba 3, the path tracer: an optional dependency, imported here alone."""

import importlib.util
from types import ModuleType

from deltasafe.errors import SettingsError

__all__ = ["VARIANTS", "load_mitsuba"]

# the first gives the same bytes on every run; the others are quicker and need LLVM (19) or CUDA on the machine
VARIANTS = ("scalar_rgb", "llvm_ad_rgb", "cuda_ad_rgb")


def load_mitsuba(variant: str | None = None) -> ModuleType:
    """The module with the given variant set; without one, with the variant that is set already, or the first.

    Raises:
        SettingsError: the variant is unknown, or Mitsuba is not installed.
    """
    if variant is not None and variant not in VARIANTS:
        raise SettingsError(f"variant must be one of {VARIANTS}, got {variant!r}")
    if importlib.util.find_spec("mitsuba") is None:
        raise SettingsError("rendering needs Mitsuba 3; install it with: pip install --group generator")
    import mitsuba

    variant = variant or mitsuba.variant() or VARIANTS[0]
    if mitsuba.variant() != variant:
        mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba
