"""Import of Mitsuba 3, the path tracer, which is an optional dependency; no other module imports it."""

from types import ModuleType

from deltasafe.errors import SettingsError

# scalar_rgb gives the same bytes on every run; the others are faster and need LLVM 19 or CUDA
VARIANTS = ("scalar_rgb", "llvm_ad_rgb", "cuda_ad_rgb")


def load_mitsuba(variant: str | None = None) -> ModuleType:
    """Import Mitsuba and select a variant; by default keep the selected variant, or select ``scalar_rgb``.

    Raises:
        SettingsError: the variant is unknown, or Mitsuba is not installed.
    """
    if variant is not None and variant not in VARIANTS:
        raise SettingsError(f"variant must be one of {VARIANTS}, got {variant!r}")
    try:
        import mitsuba
    except ModuleNotFoundError as error:
        raise SettingsError("rendering needs Mitsuba 3; install it with: pip install --group generator") from error
    variant = variant or mitsuba.variant() or VARIANTS[0]
    if mitsuba.variant() != variant:
        mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba
