"""The paper's results for perception (section V-A, Tables I to III and Fig. 4), for comparison with our results.

The column headings of the paper's Table II are swapped (decision 1); here they are corrected. The row "1000 images, our
scheme" of Table II is the M = 10 ensemble of Table III (decision 2).
"""

import dataclasses


@dataclasses.dataclass(frozen=True)
class SchemeResult:
    """A row of Tables I and II: mean and sd of PA and mIoU over members, BS and NLL of the ensemble."""

    n_images: int
    scheme: str
    pixel_accuracy: float
    pixel_accuracy_sd: float
    miou: float
    miou_sd: float
    brier: float
    nll: float


AUGMENTATION_RESULTS = (
    SchemeResult(200, "cutout", 0.882, 0.009, 0.787, 0.014, 0.0881, 0.418),
    SchemeResult(200, "mixup", 0.894, 0.014, 0.783, 0.020, 0.0683, 0.250),
    SchemeResult(200, "flip_rotate90", 0.885, 0.010, 0.794, 0.015, 0.0917, 0.475),
    SchemeResult(200, "flip_rotate_crop", 0.869, 0.013, 0.767, 0.019, 0.0974, 0.412),
    SchemeResult(200, "ours", 0.954, 0.007, 0.891, 0.014, 0.0254, 0.105),
    SchemeResult(1000, "cutout", 0.917, 0.006, 0.836, 0.008, 0.0631, 0.323),
    SchemeResult(1000, "mixup", 0.881, 0.008, 0.771, 0.011, 0.0871, 0.369),
    SchemeResult(1000, "flip_rotate90", 0.882, 0.010, 0.781, 0.014, 0.0841, 0.470),
    SchemeResult(1000, "flip_rotate_crop", 0.892, 0.011, 0.797, 0.017, 0.0802, 0.394),
    SchemeResult(1000, "ours", 0.962, 0.008, 0.910, 0.016, 0.0234, 0.114),
)
"""Tables I and II."""

ENSEMBLE_SIZE_RESULTS = {
    1: (0.0308, 0.180),
    2: (0.0297, 0.161),
    3: (0.0281, 0.139),
    4: (0.0269, 0.130),
    5: (0.0251, 0.123),
    6: (0.0243, 0.121),
    7: (0.0239, 0.119),
    8: (0.0233, 0.117),
    9: (0.0236, 0.114),
    10: (0.0234, 0.114),
}
"""Table III: M -> (BS, NLL)."""

RELIABILITY_RESULTS = {
    2: (
        (0.5133, 0.5740, 0.6246, 0.6751, 0.7252, 0.7755, 0.8257, 0.8762, 0.9274, 0.9992),
        (0.4831, 0.5664, 0.5866, 0.6162, 0.6335, 0.6601, 0.6857, 0.7153, 0.7565, 0.9867),
    ),
    5: (
        (0.5251, 0.5759, 0.6245, 0.6752, 0.7254, 0.7784, 0.8237, 0.8756, 0.9272, 0.9989),
        (0.5012, 0.5607, 0.6252, 0.6295, 0.6675, 0.7264, 0.8124, 0.8223, 0.8471, 0.9901),
    ),
    10: (
        (0.5245, 0.5753, 0.6253, 0.6754, 0.7252, 0.7771, 0.8244, 0.8807, 0.9223, 0.9989),
        (0.5143, 0.5661, 0.6073, 0.6404, 0.6950, 0.7607, 0.7982, 0.8796, 0.9036, 0.9902),
    ),
}
"""Fig. 4: M -> (confidence, accuracy) of the ten bins."""

MEMBER_RELIABILITY_RESULTS = (
    (
        (0.5251, 0.5752, 0.6254, 0.6754, 0.7255, 0.7754, 0.8259, 0.8764, 0.9280, 0.9992),
        (0.4832, 0.5109, 0.5185, 0.5393, 0.5702, 0.5911, 0.6143, 0.6463, 0.7018, 0.9846),
    ),
    (
        (0.5250, 0.5750, 0.6251, 0.6754, 0.7255, 0.7755, 0.8260, 0.8767, 0.9276, 0.9991),
        (0.4837, 0.5067, 0.5237, 0.5250, 0.5425, 0.5802, 0.5974, 0.6340, 0.6867, 0.9830),
    ),
    (
        (0.5250, 0.5749, 0.6250, 0.6753, 0.7254, 0.7758, 0.8260, 0.8767, 0.9275, 0.9991),
        (0.4872, 0.4964, 0.5103, 0.5365, 0.5568, 0.5745, 0.6172, 0.6568, 0.7102, 0.9822),
    ),
    (
        (0.5251, 0.5751, 0.6253, 0.6751, 0.7255, 0.7758, 0.8258, 0.8767, 0.9278, 0.9990),
        (0.4850, 0.5024, 0.5255, 0.5499, 0.5730, 0.6057, 0.6404, 0.6879, 0.7456, 0.9844),
    ),
    (
        (0.5250, 0.5754, 0.6252, 0.6753, 0.7256, 0.7758, 0.8260, 0.8765, 0.9276, 0.9989),
        (0.4913, 0.5160, 0.5380, 0.5569, 0.5679, 0.5894, 0.6129, 0.6438, 0.7019, 0.9827),
    ),
)
"""Fig. 4: (confidence, accuracy) of the ten bins, of each member of the M = 5 ensemble."""
