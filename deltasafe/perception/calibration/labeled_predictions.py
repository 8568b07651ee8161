"""Labels and the members' predictions of the same images, checked image by image."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import require_label, require_labeled_prediction, require_p_occupied
from deltasafe.perception.calibration.temperature import pooled_probability


class PredictionSource(Protocol):
    """N arrays (M, H, W) of the p_occupied of M members, for example a list or `MemberPredictions`."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> NDArray[np.floating]: ...


@dataclasses.dataclass(frozen=True)
class LabeledPredictions:
    """N labeled images and the predictions of M members on them.

    Attributes:
        image_ids: N unique names.
        labels: N masks (H, W), bool or 0/255; sizes may differ between images.
        predictions: of the N images; read one at a time.
        ignored: N masks (H, W) of the pixels that do not count, or None for an image in which all count; None: all
            pixels of all images count.
    """

    image_ids: Sequence[str]
    labels: Sequence[NDArray[np.generic]]
    predictions: PredictionSource
    ignored: Sequence[NDArray[np.bool_] | None] | None = None

    def __post_init__(self) -> None:
        n_images = len(self.image_ids)
        if not n_images == len(self.labels) == len(self.predictions) or n_images == 0:
            raise SettingsError(
                f"one label and one prediction per image are needed, got {n_images} ids, {len(self.labels)} labels, "
                f"{len(self.predictions)} predictions"
            )
        if len(set(self.image_ids)) != n_images:
            raise SettingsError("image_ids must be unique")

    def __len__(self) -> int:
        return len(self.image_ids)

    def checked(
        self, n_members: int | None = None
    ) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.bool_] | None]]:
        """Yield (H, W) bool label, (M, H, W) predictions and (H, W) mask of valid pixels (None: all) of each image.

        Args:
            n_members: required M; by default that of the first image.

        Raises:
            SettingsError: names the image whose label or predictions are invalid.
        """
        for image_id, label, index in zip(self.image_ids, self.labels, range(len(self)), strict=True):
            stack = self.predictions[index]
            try:
                if np.ndim(stack) != 3 or len(stack) == 0 or n_members not in (None, len(stack)):
                    raise SettingsError(
                        f"predictions must have shape (M, H, W), M the same in all images, got {np.shape(stack)}"
                    )
                n_members = len(stack)
                _, occupied = require_labeled_prediction(stack[0], label)
                p_members = require_p_occupied(stack)
                valid = self.valid(index, occupied.shape)
            except SettingsError as error:
                raise SettingsError(f"{image_id}: {error}") from error
            yield occupied, p_members, valid

    def valid(self, index: int, shape: tuple[int, ...]) -> NDArray[np.bool_] | None:
        """Return the pixels (H, W) of an image that count; None if all do.

        Raises:
            SettingsError: the mask of ignored pixels has another shape than the image, or no pixel counts.
        """
        ignored = None if self.ignored is None else self.ignored[index]
        if ignored is None:
            return None
        if ignored.shape != shape:
            raise SettingsError(f"the mask of ignored pixels has shape {ignored.shape}, its label {shape}")
        if ignored.all():
            raise SettingsError("every pixel is ignored; leave the image out")
        return ~ignored

    def pooled(
        self, index: int, temperature: float = 1.0
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_] | None]:
        """Return `pooled_probability` of all members, label, and valid pixels (None: all) of an image, each (H, W).

        The image was checked before.
        """
        p_members, label = np.asarray(self.predictions[index], dtype=np.float64), require_label(self.labels[index])
        return pooled_probability(p_members, temperature), label, self.valid(index, label.shape)
