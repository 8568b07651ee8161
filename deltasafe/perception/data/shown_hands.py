"""Do the images of an augmented set show the hands of their originals?"""

import dataclasses

from deltasafe.perception.data.augmented_set import AugmentedSet

_LEAST_SHOWN = 0.95
_COVERAGE = (0.02, 0.6)
_N_NAMED = 5


@dataclasses.dataclass(frozen=True)
class ShownHands:
    """How many images of an augmented set show a hand; originals without a hand are not counted.

    Attributes:
        by_original: fraction of the images of each original that show its hand, by id.
        coverage: fraction of their pixels that is hand.
    """

    by_original: dict[str, float]
    coverage: float

    @classmethod
    def of(cls, data: AugmentedSet) -> "ShownHands":
        """Count in all masks of a set."""
        shows: dict[str, list[bool]] = {}
        for mask, recipe in zip(data.masks, data.recipes, strict=True):
            if recipe["source"] not in data.without_hand:
                shows.setdefault(recipe["source"], []).append(bool(mask.any()))
        n_images = sum(map(len, shows.values()))
        fractions = {source: sum(found) / len(found) for source, found in shows.items()}
        return cls(fractions, float(data.masks.mean()) * data.n / n_images)

    @property
    def fraction(self) -> float:
        """Fraction of all images that show their hand."""
        return sum(self.by_original.values()) / len(self.by_original)

    @property
    def passed(self) -> bool:
        """Whether enough images show a hand, of a plausible size."""
        return self.fraction >= _LEAST_SHOWN and _COVERAGE[0] <= self.coverage <= _COVERAGE[1]

    def sentence(self) -> str:
        """State both fractions, and the remedy if one is wrong."""
        found = (
            f"{self.fraction:.1%} of the images made of a hand show it (at least 95 % required); "
            f"hands cover {self.coverage:.1%} of their pixels (2 to 60 % required)"
        )
        if self.fraction < _LEAST_SHOWN:
            lost = sorted(self.by_original, key=lambda source: (self.by_original[source], source))[:_N_NAMED]
            named = ", ".join(f"{source} ({self.by_original[source]:.0%})" for source in lost)
            return f"{found}; fewest images show the hand of {named}: crop these originals closer around the hand"
        if self.coverage < _COVERAGE[0]:
            return f"{found}; the hands are too small: crop the originals closer around them"
        return found if self.passed else f"{found}; the hands are too large: are the masks inverted?"
