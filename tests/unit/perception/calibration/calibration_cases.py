"""Synthetic labels and predictions with the errors of real members: blurred borders, shared and independent noise."""

import numpy as np
from scipy.ndimage import gaussian_filter

from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions


def synthetic_ensemble(n_images=6, n_members=3, shape=(48, 64), seed=0):
    """Labels (H, W) of 0/255 and predictions (M, H, W) float32; heights differ between images."""
    rng = np.random.default_rng(seed)
    names, labels, predictions = [], [], []
    for index in range(n_images):
        height, width = shape[0] + 4 * (index % 3), shape[1]
        y, x = np.mgrid[:height, :width]
        center = (rng.uniform(0.35, 0.65) * height, rng.uniform(0.35, 0.65) * width)
        label = np.hypot(y - center[0], (x - center[1]) * 0.7) < rng.uniform(0.2, 0.35) * height
        shared = 8 * gaussian_filter(rng.normal(size=label.shape), 3)
        own = [16 * gaussian_filter(rng.normal(size=label.shape), 2) for _ in range(n_members)]
        logit = 12 * (gaussian_filter(label.astype(float), 1.5) - 0.5)
        p_occupied = 1 / (1 + np.exp(-(logit + shared + np.array(own))))
        names.append(f"image_{index:02d}")
        labels.append(np.where(label, 255, 0).astype(np.uint8))
        predictions.append(p_occupied.astype(np.float32))
    return LabeledPredictions(names, labels, predictions)
