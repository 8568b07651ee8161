"""The model card of a frozen ensemble: Markdown made from its manifest and calibration, nothing else."""

from typing import Any

from deltasafe.perception.calibration.conformal_margin import margin_sentence
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.settings import InferenceSettings

__all__ = ["model_card"]


def model_card(manifest: dict[str, Any], calibration: Calibration) -> str:
    """Markdown text; the same input gives the same text."""
    network, inference = manifest["network"], manifest["inference"]
    height, width = InferenceSettings(**inference).network_size(inference["height"], inference["width"])
    supported = calibration.smallest_supported_delta
    delta = (
        f"The smallest delta that these images support is **{supported:g}** (at {calibration.level:.0%} confidence); "
        "planning with a smaller one is refused."
        if supported is not None
        else "These images support **no** delta: do not plan with this ensemble."
    )
    temperature = calibration.temperature
    recalibrated = "" if temperature == 1.0 else f", recalibrated by a temperature of **{temperature:.3f}**,"
    n_fitted = calibration.n_calibration_images or calibration.n_images
    threshold = (
        f"\n\nIn a new image like these at most **{calibration.missed_hand_alpha:.0%}** of the hand is expected to have"
        f" `p_occupied <= {calibration.missed_hand_threshold:.3g}` (conformal risk control on {n_fitted} images; a mean"
        " over images, no bound for each)."
        if calibration.missed_hand_alpha is not None and calibration.missed_hand_threshold is not None
        else ""
    )
    return f"""# Hand occupancy ensemble

{manifest["n_members"]} independently trained `{network["architecture"]}` networks on `{network["backbone"]}`
(seeds {", ".join(str(seed) for seed in manifest["seeds"])}); their mean{recalibrated} is the probability that a
pixel shows a hand or forearm. Images are looked at with about {inference["width"]} x {inference["height"]} pixels.

## How it was judged

On {calibration.n_images} labeled test images that no training has seen, on all pixels, at label resolution:

| pixel accuracy | mIoU | NLL (nats) | Brier score | ECE |
|---|---|---|---|---|
| {calibration.pixel_accuracy:.4f} | {calibration.miou:.4f} | {calibration.nll:.4f} | {calibration.brier:.4f} \
| {calibration.expected_calibration_error:.4f} |

{delta}{threshold}{margin_sentence(calibration.conformal_margins)}

## Intended use

Occupancy for motion planning around one hand seen from above, held still, filling roughly 5 to 50 % of the
picture. The guarantee it can take part in is pointwise (each point, each time); it bounds neither the
probability that a whole motion collides nor anything about a hand that moves.

## Limits

Trained on augmentations of a small set of labeled images (the packaged set is rendered, not photographed).
Architecture, number of epochs and inference size were chosen while looking at the packaged test images, so the
figures above are slightly too good for new ones. Expect failures on what no training image shows: small hands far
away, several hands, faces and other bare skin, gloves, strong motion blur.

## How to use it

```python
import deltasafe
ensemble = deltasafe.load_ensemble("FOLDER")      # verifies every file first
p_occupied = ensemble.p_occupied(rgb)             # uint8 (H, W, 3) -> float32 (H, W)
```

or `ensemble.onnx` with any ONNX runtime: input `rgb`, uint8 (B, h, w, 3), any size, best about
{height} x {width}; outputs `p_occupied` (B, h, w), recalibrated, and `member_p_occupied` and `member_logits`
(B, M, h, w), as the members say it.
"""
