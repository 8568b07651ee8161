"""Do the images of an augmented set show the hands of their originals?"""

import dataclasses

from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo

_LEAST_SHOWN = 0.95
_N_NAMED = 5


@dataclasses.dataclass(frozen=True)
class ShownHands:
    """How many images of an augmented set show a hand; originals without a hand are not counted.

    Attributes:
        by_original: fraction of the images of each original that show its hand, by id.
        coverage: fraction of their pixels that is hand.
        info: what the set shows, and the coverage that it allows.
    """

    by_original: dict[str, float]
    coverage: float
    info: DatasetInfo = HANDS

    @classmethod
    def of(cls, data: AugmentedSet) -> "ShownHands":
        """Count in all masks of a set."""
        shows: dict[str, list[bool]] = {}
        for mask, recipe in zip(data.masks, data.recipes, strict=True):
            if recipe["source"] not in data.without_hand:
                shows.setdefault(recipe["source"], []).append(bool(mask.any()))
        n_images = sum(map(len, shows.values()))
        fractions = {source: sum(found) / len(found) for source, found in shows.items()}
        return cls(fractions, float(data.masks.mean()) * data.n / n_images, data.info)

    @property
    def fraction(self) -> float:
        """Fraction of all images that show their hand."""
        return sum(self.by_original.values()) / len(self.by_original)

    @property
    def passed(self) -> bool:
        """Whether enough images show a hand, of a plausible size."""
        return self.fraction >= _LEAST_SHOWN and self.info.coverage[0] <= self.coverage <= self.info.coverage[1]

    def sentence(self) -> str:
        """State both fractions, and the remedy if one is wrong."""
        thing, things, (least, most) = self.info.singular, self.info.plural, self.info.coverage
        found = (
            f"{self.fraction:.1%} of the images made of {self.info.with_article} show it (at least 95 % required); "
            f"{things} cover {self.coverage:.1%} of their pixels ({100 * least:g} to {100 * most:g} % required)"
        )
        if self.fraction < _LEAST_SHOWN:
            lost = sorted(self.by_original, key=lambda source: (self.by_original[source], source))[:_N_NAMED]
            named = ", ".join(f"{source} ({self.by_original[source]:.0%})" for source in lost)
            return f"{found}; fewest images show the {thing} of {named}: crop these originals closer around the {thing}"
        if self.coverage < least:
            return f"{found}; the {things} are too small: crop the originals closer around them"
        return found if self.passed else f"{found}; the {things} are too large: are the masks inverted?"
