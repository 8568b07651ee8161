"""Who it is: the shape of the body and the look of the skin, and how people are drawn at random."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from generator.arm import ArmModel

__all__ = ["ALIKE", "Body", "Person", "Skin", "draw_person", "shaped_points_m"]

Array = NDArray[np.float64]
DECIMETRE = 0.1
NAIL_POLISHES = ((150, 20, 40), (200, 60, 90), (30, 30, 35), (60, 90, 150), (235, 200, 195))


@dataclasses.dataclass(frozen=True)
class Body:
    """Shape of the arm. The first four run from 0 to 1; the last four are signed, about 0.35 standard deviation.

    Attributes:
        masculinity, age, muscle, weight: 0 to 1.
        ancestry: shares of MakeHuman's African, Asian and Caucasian targets; they are scaled to sum to one.
        finger_diameter, finger_length, hand_scale, forearm_fat: -1 to 1.

    Raises:
        SettingsError: a share is outside its range.
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
        for name in ("masculinity", "age", "muscle", "weight"):
            if not 0 <= getattr(self, name) <= 1:
                raise SettingsError(f"{name} must lie between 0 and 1, got {getattr(self, name)}")
        if len(self.ancestry) != 3 or min(self.ancestry) < 0 or sum(self.ancestry) <= 0:
            raise SettingsError(f"ancestry must be three shares with a positive sum, got {self.ancestry}")


@dataclasses.dataclass(frozen=True)
class Skin:
    """Look of the skin.

    Attributes:
        tone: 0 (lightest) to 9 (darkest).
        redness, veins, wrinkles, hair, freckles: strength, 0 (none) to about 1.
        nail_polish: sRGB 0 to 255, or None.
        seed: of lines, veins and mottling.

    Raises:
        SettingsError: the tone is outside of the palette.
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
        if not 0 <= self.tone <= 9:
            raise SettingsError(f"tone must lie between 0 (lightest) and 9 (darkest), got {self.tone}")


@dataclasses.dataclass(frozen=True)
class Person:
    """A body and its skin."""

    body: Body
    skin: Skin


ALIKE = (
    Person(Body(1.0, 0.1, 0.6, 0.5), Skin(1.7, 0.7, 0.45, 0.5, hair=0.35)),
    Person(Body(0.8, 0.0, 0.5, 0.4, (0.0, 0.2, 0.8)), Skin(2.3, 0.55, 0.3, 0.4, hair=0.15)),
)


def draw_person(rng: np.random.Generator, tones: tuple[float, float] = (0.0, 9.0)) -> Person:
    """Anyone: any sex, age, build, ancestry, and a skin tone uniform in ``tones``."""
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
    polished = rng.random() < (0.06 if masculinity else 0.35)
    polish = NAIL_POLISHES[rng.integers(len(NAIL_POLISHES))]
    skin = Skin(
        tone=float(rng.uniform(*tones)),
        redness=float(rng.uniform(0.2, 1)),
        veins=float(rng.uniform(0, 0.5 + 0.4 * age)),
        wrinkles=float(rng.uniform(0.2, 0.6) + 0.6 * age),
        hair=float(masculinity * rng.uniform(0, 0.8)),
        freckles=float((rng.random() < 0.2) * rng.uniform(0.3, 0.9)),
        nail_polish=polish if polished else None,
        seed=int(rng.integers(1 << 20)),
    )
    return Person(body, skin)


def shaped_points_m(arm: ArmModel, body: Body) -> Array:
    """The model's points (P, 3) in metres with the targets of ``body`` applied (MakeHuman's macro details)."""
    points = arm.points_dm.copy()
    shares = np.array(body.ancestry) / sum(body.ancestry)
    for sex, of_sex in (("female", 1 - body.masculinity), ("male", body.masculinity)):
        for years, of_years in (("young", 1 - body.age), ("old", body.age)):
            share = of_sex * of_years
            for ancestry, of_ancestry in zip(("african", "asian", "caucasian"), shares, strict=True):
                points += share * of_ancestry * arm.targets[f"{ancestry}-{sex}-{years}"]
            for muscle, of_muscle in _thirds(body.muscle).items():
                for weight, of_weight in _thirds(body.weight).items():
                    target = arm.targets.get(f"universal-{sex}-{years}-{muscle}muscle-{weight}weight")
                    if target is not None:
                        points += share * of_muscle * of_weight * target
    details = {
        "l-hand-fingers-diameter": body.finger_diameter,
        "l-hand-fingers-length": body.finger_length,
        "l-hand-scale": body.hand_scale,
        "l-lowerarm-fat": body.forearm_fat,
    }
    for name, amount in details.items():
        points += abs(amount) * arm.targets[f"{name}-{'incr' if amount > 0 else 'decr'}"]
    return points * DECIMETRE


def _thirds(x: float) -> dict[str, float]:
    return {"min": max(0.0, 1 - 2 * x), "average": 1 - abs(2 * x - 1), "max": max(0.0, 2 * x - 1)}
