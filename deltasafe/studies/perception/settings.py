"""The cells of the studies of section V-A. Imports neither torch nor OpenCV, because the UI lists the cells."""

import dataclasses

from deltasafe.errors import SettingsError
from deltasafe.perception.data.augmentation.settings import METHOD_NAMES
from deltasafe.perception.data.schemes import SCHEMES
from deltasafe.setting_ranges import check_range


@dataclasses.dataclass(frozen=True)
class Cell:
    """An ensemble to train and evaluate: a scheme at a size; in the ablation, with one method left out.

    Attributes:
        scheme: a name of `deltasafe.perception.data.schemes.SCHEMES`.
        n_images: size of the augmented set.
        n_members: M.
        left_out: method of our scheme that is not applied; empty for the whole scheme.
        full: trained with the recipe of the preset although the comparisons have a lighter one.
    """

    scheme: str
    n_images: int
    n_members: int
    left_out: str = ""
    full: bool = False

    def __post_init__(self) -> None:
        if self.scheme not in SCHEMES:
            raise SettingsError(f"scheme is {self.scheme!r}; choose one of {', '.join(SCHEMES)}")
        if self.left_out and (self.scheme != "ours" or self.left_out not in METHOD_NAMES):
            raise SettingsError(
                f"left_out is {self.left_out!r}; only our scheme has methods: {', '.join(METHOD_NAMES)}"
            )
        check_range(self, "[1, inf)", "n_images", "n_members")

    @property
    def name(self) -> str:
        """Name of partitions and figures: ``mixup-200``, ``ours-1000-without-flip``, ``ours-1000-full``."""
        without = f"-without-{self.left_out}" if self.left_out else ""
        return f"{self.scheme}-{self.n_images}{without}{'-full' if self.full else ''}"


@dataclasses.dataclass(frozen=True)
class StudySettings:
    """Extent of the studies; network, training and inference are those of the preset.

    Tables I and II and the ablation can have a lighter recipe, the same for all of their cells. They only compare
    schemes, and their ensembles would take a day on two cores. Table III and Fig. 4 have the recipe of the preset.

    Attributes:
        sizes: of the augmented sets; every cell is trained with as many gradient steps as one of the largest size.
        n_members: M of Tables I and II, the same for every scheme.
        n_members_most: largest M of Table III (our scheme at the largest size).
        n_members_ablation: M with one method left out; compared with the same number of members of the whole scheme.
        left_out: methods of the ablation, each left out once, at the largest size.
        cutout_side: see `CutoutSettings`.
        mixup_alpha: see `MixupSettings`.
        comparison_width: width of the training images of Tables I and II and the ablation, in pixels; the size of
            inference is scaled accordingly. 0: as in the preset.
        comparison_epochs: epochs over a set of the largest size, for the same cells. 0: as in the preset.
        first_seed: member m of every cell has the seed ``first_seed`` + m.
    """

    sizes: tuple[int, ...] = (200, 1000)
    n_members: int = 5
    n_members_most: int = 10
    n_members_ablation: int = 2
    left_out: tuple[str, ...] = METHOD_NAMES
    cutout_side: float = 0.5
    mixup_alpha: float = 0.4
    comparison_width: int = 0
    comparison_epochs: int = 0
    first_seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "sizes", tuple(self.sizes))
        object.__setattr__(self, "left_out", tuple(self.left_out))
        check_range(self, "[1, inf)", "sizes")
        if list(self.sizes) != sorted(set(self.sizes)):
            raise SettingsError(f"sizes must be ascending, got {self.sizes}")
        check_range(self, "[1, inf)", "n_members_most", "n_members")
        check_range(self, f"[1, {self.n_members_most}]", "n_members")
        check_range(self, f"[1, {self.n_members}]", "n_members_ablation")
        check_range(self, "[0, inf)", "first_seed", "comparison_width", "comparison_epochs")
        self.cells()

    @property
    def has_comparison_recipe(self) -> bool:
        """Whether the comparisons have a lighter recipe than the preset."""
        return self.comparison_width > 0 or self.comparison_epochs > 0

    @property
    def largest(self) -> Cell:
        """Our scheme at the largest size with the recipe of the preset: the ensemble of Table III."""
        return Cell("ours", self.sizes[-1], self.n_members_most, full=self.has_comparison_recipe)

    def schemes(self) -> tuple[Cell, ...]:
        """Return the cells of Tables I and II, in the order of the paper."""
        cells = [Cell(scheme, n_images, self.n_members) for n_images in self.sizes for scheme in SCHEMES]
        return tuple(self.largest if cell.name == self.largest.name else cell for cell in cells)

    def ablation(self) -> tuple[Cell, ...]:
        """Return the cells of the ablation: our scheme with one method left out."""
        return tuple(Cell("ours", self.sizes[-1], self.n_members_ablation, method) for method in self.left_out)

    def cells(self) -> tuple[Cell, ...]:
        """Return all cells in the order of work: our scheme first, the largest sets first, the ablation last."""
        schemes = sorted(self.schemes(), key=lambda cell: (cell.scheme != "ours", -cell.n_images))
        return tuple(dict.fromkeys((self.largest, *schemes, *self.ablation())))
