"""People: body shape and skin appearance, and how they are sampled."""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from deltasafe.errors import SettingsError
from deltasafe.setting_ranges import check_range
from generator.aliases import Array
from generator.arm import ArmModel

METERS_PER_DECIMETER = 0.1
NAIL_POLISHES_SRGB = ((150, 20, 40), (200, 60, 90), (30, 30, 35), (60, 90, 150), (235, 200, 195))
ANCESTRIES = ("african", "asian", "caucasian")


@dataclasses.dataclass(frozen=True)
class Body:
    """Shape of the arm, as weights of MakeHuman's targets.

    Attributes:
        masculinity, age, muscle, weight: 0 to 1.
        ancestry: weights of the African, Asian and Caucasian targets; they are normalized to sum to one.
        finger_diameter, finger_length, hand_scale, forearm_fat: -1 to 1; sampled with a standard deviation of 0.35.

    Raises:
        SettingsError: a value is outside its range.
    """

    masculinity: float = 1.0
    age: float = 0.0
    muscle: float = 0.5
    weight: float = 0.5
    ancestry: tuple[float, float, float] = (0.0, 0.0, 1.0)
    finger_diameter: float = 0.0
    finger_length: float = 0.0
    hand_scale: float = 0.0
    forearm_fat: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "[0, 1]", "masculinity", "age", "muscle", "weight")
        if len(self.ancestry) != 3 or min(self.ancestry) < 0 or sum(self.ancestry) <= 0:
            raise SettingsError(f"ancestry must be three weights with a positive sum, got {self.ancestry}")


@dataclasses.dataclass(frozen=True)
class Skin:
    """Appearance of the skin.

    Attributes:
        tone: 0 (lightest) to 9 (darkest).
        redness, veins, wrinkles, hair, freckles: strength, 0 (none) to about 1.
        nail_polish: sRGB 0 to 255, or None.
        seed: random seed of palm lines, veins and mottling.

    Raises:
        SettingsError: the tone is outside its range.
    """

    tone: float = 2.0
    redness: float = 0.6
    veins: float = 0.4
    wrinkles: float = 0.5
    hair: float = 0.0
    freckles: float = 0.0
    nail_polish: tuple[int, int, int] | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_range(self, "[0, 9]", "tone")


@dataclasses.dataclass(frozen=True)
class Person:
    """A body and its skin."""

    body: Body
    skin: Skin


SIMILAR_PEOPLE = (
    Person(Body(1.0, 0.1, 0.6, 0.5), Skin(1.7, 0.7, 0.45, 0.5, hair=0.35)),
    Person(Body(0.8, 0.0, 0.5, 0.4, (0.0, 0.2, 0.8)), Skin(2.3, 0.55, 0.3, 0.4, hair=0.15)),
)


def sample_person(rng: np.random.Generator, tones: tuple[float, float] = (0.0, 9.0)) -> Person:
    """Sample a person of any sex, age, build and ancestry, with a skin tone uniform in ``tones``."""
    masculinity = float(rng.random() < 0.5)
    age = float(rng.choice([0.0, 0.2, 0.5, 0.9], p=[0.35, 0.3, 0.2, 0.15]))
    diameter, length, scale, fat = np.clip(rng.normal(0, 0.35, 4), -1, 1).tolist()
    body = Body(
        masculinity=masculinity,
        age=age,
        muscle=float(rng.uniform(0.2, 0.9)),
        weight=float(rng.uniform(0.2, 0.85)),
        ancestry=tuple(rng.dirichlet([0.6, 0.6, 0.6]).tolist()),
        finger_diameter=diameter,
        finger_length=length,
        hand_scale=scale,
        forearm_fat=fat,
    )
    has_polish = rng.random() < (0.06 if masculinity else 0.35)
    polish = NAIL_POLISHES_SRGB[rng.integers(len(NAIL_POLISHES_SRGB))]
    skin = Skin(
        tone=float(rng.uniform(*tones)),
        redness=float(rng.uniform(0.2, 1)),
        veins=float(rng.uniform(0, 0.5 + 0.4 * age)),
        wrinkles=float(rng.uniform(0.2, 0.6) + 0.6 * age),
        hair=float(masculinity * rng.uniform(0, 0.8)),
        freckles=float((rng.random() < 0.2) * rng.uniform(0.3, 0.9)),
        nail_polish=polish if has_polish else None,
        seed=int(rng.integers(1 << 20)),
    )
    return Person(body, skin)


def shaped_points_m(arm: ArmModel, body: Body) -> Array:
    """Return the model's points (P, 3) in meters with the shape targets of ``body`` applied."""
    details = {
        "l-hand-fingers-diameter": body.finger_diameter,
        "l-hand-fingers-length": body.finger_length,
        "l-hand-scale": body.hand_scale,
        "l-lowerarm-fat": body.forearm_fat,
    }
    points = arm.points_dm.copy()
    for target, weight in macro_target_weights(body):
        if target in arm.targets:
            points += weight * arm.targets[target]
    for target, amount in details.items():
        points += abs(amount) * arm.targets[f"{target}-{'incr' if amount > 0 else 'decr'}"]
    return points * METERS_PER_DECIMETER


def macro_target_weights(body: Body) -> Iterator[tuple[str, float]]:
    """Yield the name and weight of each of MakeHuman's macro targets; MakeHuman has no file for some of the names."""
    ancestry_weights = np.array(body.ancestry) / sum(body.ancestry)
    sexes = (("female", 1 - body.masculinity), ("male", body.masculinity))
    ages = (("young", 1 - body.age), ("old", body.age))
    for (sex, sex_weight), (age, age_weight) in itertools.product(sexes, ages):
        base = sex_weight * age_weight
        for ancestry, weight in zip(ANCESTRIES, ancestry_weights, strict=True):
            yield f"{ancestry}-{sex}-{age}", base * weight
        for (muscle, muscle_weight), (fat, fat_weight) in itertools.product(_levels(body.muscle), _levels(body.weight)):
            yield f"universal-{sex}-{age}-{muscle}muscle-{fat}weight", base * muscle_weight * fat_weight


def _levels(x: float) -> tuple[tuple[str, float], ...]:
    """Linear interpolation weights of the levels min (0), average (0.5) and max (1)."""
    return ("min", max(0.0, 1 - 2 * x)), ("average", 1 - abs(2 * x - 1)), ("max", max(0.0, 2 * x - 1))
