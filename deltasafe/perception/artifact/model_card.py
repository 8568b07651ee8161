"""Model card of a frozen ensemble: Markdown from its manifest and calibration."""

from typing import Any

from deltasafe.perception.artifact.manifest import inference_of_manifest
from deltasafe.perception.calibration.conformal_margin import margin_sentence
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.reporting.templates import render


def model_card(manifest: dict[str, Any], calibration: Calibration) -> str:
    """Fill the template; the same input gives the same text."""
    inference = inference_of_manifest(manifest)
    height, width = inference.network_size(inference.height, inference.width)
    return render(
        "deltasafe.perception.artifact",
        "model_card.md.j2",
        **manifest | {"inference": inference},
        calibration=calibration,
        margin_sentence=margin_sentence(calibration.conformal_margins).strip(),
        height=height,
        width=width,
    )
