"""Predictions of all members on a set of images, stored on disk and memory-mapped on access."""

import pathlib
from collections.abc import Callable, Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.perception.calibration.metrics import require_p_occupied

Array = NDArray[np.float32]


class MemberPredictions(Sequence[Array]):
    """A folder of N files ``NNNN.npy``, each (M, H, W) float32 p_occupied, memory-mapped when indexed.

    Ensembles of any size are means over the first members, so each image is predicted once.

    Attributes:
        image_ids: ids of the N images, in order.
        n_members: M.
    """

    def __init__(self, folder: str | pathlib.Path) -> None:
        """Open a folder of `MemberPredictions.write`.

        Raises:
            DataError: the index is missing or malformed.
        """
        self.folder = pathlib.Path(folder)
        index = read_json(self.folder / "index.json")
        try:
            self.image_ids = tuple(str(name) for name in index["image_ids"])
            self.n_members = int(index["n_members"])
        except (KeyError, TypeError, ValueError):
            raise DataError(self.folder / "index.json", "needs image_ids and n_members; predict again") from None

    @classmethod
    def write(
        cls,
        folder: str | pathlib.Path,
        image_ids: Sequence[str],
        predict: Callable[[str], NDArray[np.floating]],
        progress: Progress = silent,
    ) -> "MemberPredictions":
        """Predict every image with all members, and replace ``folder`` atomically.

        Args:
            image_ids: unique ids of the images.
            predict: returns the members' p_occupied (M, H, W) of an image id.

        Raises:
            SettingsError: no image, repeated ids, or a prediction outside [0, 1] or of another shape.
        """
        if not image_ids or len(set(image_ids)) != len(image_ids):
            raise SettingsError(f"image_ids must be unique and at least one, got {len(image_ids)} ids")
        n_members = 0
        with atomic_folder(folder) as temporary:
            for index, image_id in enumerate(image_ids):
                stack = np.asarray(predict(image_id), dtype=np.float32)
                if stack.ndim != 3 or 0 in stack.shape or n_members not in (0, len(stack)):
                    raise SettingsError(
                        f"predictions of {image_id} must have shape (M, H, W) with the same M, got {stack.shape}"
                    )
                require_p_occupied(stack)
                n_members = len(stack)
                np.save(temporary / _file_name(index), stack, allow_pickle=False)
                progress(index + 1, len(image_ids), f"predicted {image_id}")
            write_json(temporary / "index.json", {"image_ids": list(image_ids), "n_members": n_members})
        return cls(folder)

    def __len__(self) -> int:
        return len(self.image_ids)

    @overload
    def __getitem__(self, index: int) -> Array: ...
    @overload
    def __getitem__(self, index: slice) -> list[Array]: ...
    def __getitem__(self, index: int | slice) -> Array | list[Array]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        path = self.folder / _file_name(range(len(self))[index])
        try:
            stack = np.load(path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError) as error:
            raise DataError(path, f"cannot be read ({error}); predict again") from error
        if stack.ndim != 3 or len(stack) != self.n_members:
            raise DataError(path, f"must be ({self.n_members}, H, W), got {stack.shape}; predict again")
        return np.asarray(stack)


def _file_name(index: int) -> str:
    return f"{index:04d}.npy"
