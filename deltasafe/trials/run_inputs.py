"""Check all folders that a run reads before the run starts: a defect would otherwise end it after hours of training."""

import dataclasses
import functools
import pathlib
from collections.abc import Callable
from typing import Any

from deltasafe.errors import DataError, DeltasafeError
from deltasafe.perception.data.augmentation.background import Backgrounds
from deltasafe.perception.data.labeled_images import LabeledImageSet, check_disjoint, check_distinct
from deltasafe.trials.occupancy_fields import read_scene_image, read_true_mask
from deltasafe.trials.selection import chosen_scenes


@dataclasses.dataclass(frozen=True)
class InputFolder:
    """A folder, and the file of SHA-256 digests that its files must have; None: any content."""

    folder: pathlib.Path
    registry: pathlib.Path | None = None


@dataclasses.dataclass(frozen=True)
class RunInputs:
    """The folders that a run reads; None: the run does not read it, or takes it from an earlier run.

    Attributes:
        training, test, calibration: labeled images.
        backgrounds: pictures for the augmentation.
        scenes: logged scenes.
        n_scenes: number of scenes that are used; 0 means all.
    """

    training: InputFolder | None = None
    test: InputFolder | None = None
    calibration: InputFolder | None = None
    backgrounds: InputFolder | None = None
    scenes: InputFolder | None = None
    n_scenes: int = 0

    def defects(self) -> list[str]:
        """Read every file of every folder; return one message per defective folder, empty if there is none.

        Images that are in two sets, or twice in a test or calibration set, count as defects.
        """
        found: list[str] = []

        def attempt(what: str, check: Callable[[], Any]) -> Any:
            try:
                return check()
            except DeltasafeError as error:
                found.append(f"{what}: {error}")
                return None

        sets = {
            role: attempt(f"{role} images", functools.partial(LabeledImageSet.load, given.folder, given.registry))
            for role in ("training", "test", "calibration")
            if (given := getattr(self, role)) is not None
        }
        for role in ("test", "calibration"):
            if (images := sets.get(role)) is not None:
                attempt(f"{role} images", functools.partial(check_distinct, images, role))
        for role, other in (("training", "test"), ("training", "calibration"), ("calibration", "test")):
            one, two = sets.get(role), sets.get(other)
            if one is not None and two is not None:
                attempt(f"{other} images", functools.partial(check_disjoint, one, two, role))
        if self.backgrounds is not None:
            attempt("backgrounds", functools.partial(Backgrounds.load, self.backgrounds.folder))
        if self.scenes is not None:
            attempt("scenes", self._check_scenes)
        return found

    def _check_scenes(self) -> None:
        """Read the scenes with their images and masks, as later steps do."""
        assert self.scenes is not None
        defects: list[DataError] = []
        for scene in chosen_scenes(self.scenes.folder, self.n_scenes):
            try:
                read_true_mask(scene, read_scene_image(scene).shape[:2])
            except DataError as error:
                defects.append(error)
        if defects:
            raise DataError.combined(self.scenes.folder, defects)
