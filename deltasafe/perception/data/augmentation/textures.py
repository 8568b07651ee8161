"""Procedural surfaces: tables, floors, fabrics and walls without photographs."""

import cv2
import numpy as np


def random_surface(rng: np.random.Generator, width: int, height: int) -> tuple[np.ndarray, str]:
    """Draw a surface ``(H, W, 3)`` float32 in [0, 1]; returns it with the name of its kind."""
    kind = str(rng.choice(list(SURFACES), p=[probability for _, probability in SURFACES.values()]))
    return np.clip(SURFACES[kind][0](rng, width, height), 0.0, 1.0).astype(np.float32), kind


def smooth_noise(rng: np.random.Generator, width: int, height: int, cell_x: float, cell_y: float) -> np.ndarray:
    """Value noise ``(H, W)`` in about [-1, 1], interpolated between cells of the given size in pixels."""
    shape = (max(2, round(height / cell_y) + 2), max(2, round(width / cell_x) + 2))
    coarse = rng.uniform(-1.0, 1.0, shape).astype(np.float32)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def hsv_to_rgb(hue_deg: float, saturation: float, value: float) -> np.ndarray:
    """RGB ``(3,)`` float32 in [0, 1] of a color in HSV."""
    return cv2.cvtColor(np.array([[(hue_deg, saturation, value)]], np.float32), cv2.COLOR_HSV2RGB)[0, 0]


def random_color(rng: np.random.Generator) -> np.ndarray:
    """Draw a color ``(3,)`` in [0, 1]: of wood, nearly gray, or of any hue and saturation."""
    kind = rng.random()
    if kind < 0.25:  # wood, leather, sand: the hues of skin, on purpose
        return hsv_to_rgb(rng.uniform(8, 40), rng.uniform(0.15, 0.75), rng.uniform(0.12, 0.9))
    if kind < 0.5:
        return hsv_to_rgb(rng.uniform(0, 360), rng.uniform(0, 0.15), rng.uniform(0.05, 1.0))
    return hsv_to_rgb(rng.uniform(0, 360), rng.uniform(0.2, 1.0), rng.uniform(0.15, 1.0))


def light_gradient(rng: np.random.Generator, width: int, height: int, strength: float) -> np.ndarray:
    """Factor ``(H, W, 1)`` around 1 that changes linearly over the image, like light from one side."""
    angle_rad = rng.uniform(0, 2 * np.pi)
    x, y = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)
    slope = np.cos(angle_rad) * x[None, :] + np.sin(angle_rad) * y[:, None]
    return (1.0 + strength * slope)[..., None].astype(np.float32)


def _plain(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    grain = rng.standard_normal((height, width, 1)).astype(np.float32) * rng.uniform(0, 0.05)
    return random_color(rng) * light_gradient(rng, width, height, rng.uniform(0, 0.4)) + grain


def _clouded(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    first, second = random_color(rng), random_color(rng)
    noise = np.zeros((height, width), np.float32)
    cell = rng.uniform(20, 140)
    for octave in range(5):
        noise += smooth_noise(rng, width, height, cell / 2**octave, cell / 2**octave) * 0.6**octave
    blend = np.clip(0.5 + rng.uniform(0.2, 0.9) * noise, 0, 1)[..., None]
    return first * (1 - blend) + (second if rng.random() < 0.5 else first * rng.uniform(0.5, 0.9)) * blend


def _wood(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    side = int(np.hypot(width, height)) + 2
    base = hsv_to_rgb(rng.uniform(5, 42), rng.uniform(0.2, 0.8), rng.uniform(0.2, 0.9))
    fine, coarse = rng.uniform(1.5, 4), rng.uniform(8, 30)
    grain = 0.6 * smooth_noise(rng, side, side, rng.uniform(60, 300), fine)
    grain += 0.6 * smooth_noise(rng, side, side, 250, coarse)
    rings = np.sin((np.arange(side)[:, None] + 25 * smooth_noise(rng, side, side, 200, 60)) / coarse * 2)
    grain += rng.uniform(0, 0.5) * rings.astype(np.float32)
    wood = base * (1.0 + rng.uniform(0.1, 0.35) * grain[..., None])
    if rng.random() < 0.5:  # boards
        board = int(rng.uniform(40, 130))
        tone = rng.uniform(0.8, 1.15, side // board + 1).astype(np.float32)
        wood *= np.repeat(tone, board)[:side, None, None]
        wood[::board] *= 0.5
    return _rotated(rng, wood, width, height)


def _speckled(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    size = rng.uniform(0.8, 4.5)
    noise = cv2.GaussianBlur(rng.standard_normal((height, width), dtype=np.float32), (0, 0), size)
    noise = noise / (noise.std() + 1e-6)
    color, other = random_color(rng), random_color(rng)
    blend = (1 / (1 + np.exp(-rng.uniform(1, 5) * (noise + rng.uniform(-0.8, 0.8)))))[..., None]
    return color * (1 - blend) + other * blend


def _gravel(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    pitch = rng.uniform(7, 22)
    n_x, n_y = int(width / pitch) + 2, int(height / pitch) + 2
    seeds = np.ones((height, width), np.uint8)
    xs = (np.arange(n_x)[None, :] + rng.uniform(0, 1, (n_y, n_x))) * pitch
    ys = (np.arange(n_y)[:, None] + rng.uniform(0, 1, (n_y, n_x))) * pitch
    keep = (xs < width) & (ys < height)
    seeds[ys[keep].astype(int), xs[keep].astype(int)] = 0
    distance, labels = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    tone = rng.uniform(0.4, 1.3, int(labels.max()) + 1).astype(np.float32)
    tint = 1 + rng.uniform(-0.15, 0.15, (int(labels.max()) + 1, 3)).astype(np.float32)
    shade = 1.15 - 0.8 * np.clip(distance / pitch, 0, 1)
    return random_color(rng) * tint[labels] * (tone[labels] * shade)[..., None]


def _striped(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    side = int(np.hypot(width, height)) + 2
    pitch, colors = rng.uniform(8, 60), [random_color(rng) for _ in range(int(rng.integers(2, 4)))]
    rows = (np.arange(side) / pitch).astype(int)
    pattern = np.array(colors, np.float32)[rows % len(colors)][:, None] * np.ones((1, side, 1), np.float32)
    if rng.random() < 0.5:  # a checked or woven fabric
        pattern = 0.5 * pattern + 0.5 * pattern.transpose(1, 0, 2)
    return _rotated(rng, pattern * (1 + 0.05 * rng.standard_normal((side, side, 1))), width, height)


def _tiled(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    side = int(np.hypot(width, height)) + 2
    pitch_x, pitch_y = int(rng.uniform(25, 120)), int(rng.uniform(25, 90))
    tones = rng.uniform(0.8, 1.2, (side // pitch_y + 1, side // pitch_x + 1)).astype(np.float32)
    tiles = np.repeat(np.repeat(tones, pitch_y, 0), pitch_x, 1)[:side, :side, None] * random_color(rng)
    joint, thickness = random_color(rng), int(rng.integers(1, 5))
    for start in range(thickness):
        tiles[start::pitch_y] = joint
        tiles[:, start::pitch_x] = joint
    return _rotated(rng, tiles * (1 + 0.1 * smooth_noise(rng, side, side, 6, 6)[..., None]), width, height)


def _patterned(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    side = int(np.hypot(width, height)) + 2
    n, colors = int(rng.integers(6, 14)), np.array([random_color(rng) for _ in range(4)], np.float32)
    quarter = rng.integers(0, 4, (n, n))
    half = np.concatenate([quarter, quarter[:, ::-1]], 1)
    motif = colors[np.concatenate([half, half[::-1]], 0)]
    scale = rng.uniform(2, 7)
    repeats = int(side / (2 * n * scale)) + 1
    carpet = np.tile(motif, (repeats, repeats, 1))
    carpet = cv2.resize(carpet, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    carpet = carpet[:side, :side] if min(carpet.shape[:2]) >= side else cv2.resize(carpet, (side, side))
    return _rotated(rng, carpet * (1 + 0.08 * rng.standard_normal((side, side, 1))), width, height)


def _rotated(rng: np.random.Generator, square: np.ndarray, width: int, height: int) -> np.ndarray:
    side = square.shape[0]
    matrix = cv2.getRotationMatrix2D((side / 2, side / 2), float(rng.uniform(0, 360)), 1.0)
    matrix[:, 2] += (width / 2 - side / 2, height / 2 - side / 2)
    rotated = cv2.warpAffine(square.astype(np.float32), matrix, (width, height), borderMode=cv2.BORDER_REFLECT)
    return rotated * light_gradient(rng, width, height, float(rng.uniform(0, 0.3)))


# kind: function and probability. Most tables are plain, wooden or slightly mottled.
SURFACES = {
    "plain": (_plain, 0.26),
    "clouded": (_clouded, 0.16),
    "wood": (_wood, 0.22),
    "speckled": (_speckled, 0.1),
    "gravel": (_gravel, 0.06),
    "striped": (_striped, 0.07),
    "tiled": (_tiled, 0.07),
    "patterned": (_patterned, 0.06),
}
