"""Model card of a frozen ensemble: Markdown from its manifest and calibration."""

from typing import Any

from deltasafe.perception.artifact.manifest import inference_of_manifest
from deltasafe.perception.calibration.conformal_margin import margin_sentence
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.reporting.templates import render


def model_card(manifest: dict[str, Any], calibration: Calibration, info: DatasetInfo = HANDS) -> str:
    """Fill the template; the same input gives the same text. ``info`` is about the images of the calibration."""
    inference = inference_of_manifest(manifest)
    height, width = inference.network_size(inference.height, inference.width)
    return render(
        "deltasafe.perception.artifact",
        "model_card.md.j2",
        **manifest | {"inference": inference},
        calibration=calibration,
        info=info,
        margin_sentence=margin_sentence(calibration.conformal_margins, info.singular).strip(),
        height=height,
        width=width,
    )
