"""Webcam and subsurface scattering: preserved means, visible effects, deterministic bytes."""

import dataclasses
import io

import numpy as np
import pytest
from PIL import Image

from generator.stage import camera_looking_at
from generator.subsurface import SkinBuffers, scatter
from generator.webcam import Webcam, webcam_jpeg
from tests.unit.generator.oracles import silhouette

RNG = np.random.default_rng(0)
PLAIN = Webcam(noise=0.0, blur_px=0.0, vignette=0.0, sharpening=0.0, jpeg_quality=95)


def developed(radiance, coverage=None, **changes):
    coverage = np.zeros(radiance.shape[:2]) if coverage is None else coverage
    jpeg = webcam_jpeg(radiance, coverage, dataclasses.replace(PLAIN, **changes))
    return np.asarray(Image.open(io.BytesIO(jpeg)), dtype=float)


def test_jpeg_bytes_depend_on_seed_only():
    radiance, webcam = RNG.uniform(0, 2, (24, 32, 3)), Webcam(noise=0.02, motion_px=3.0)
    one, same, other = (
        webcam_jpeg(radiance, np.zeros((24, 32)), dataclasses.replace(webcam, seed=s)) for s in (0, 0, 1)
    )
    assert one == same != other


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_auto_exposure_removes_light_level(scale):
    radiance = RNG.uniform(0.2, 1, (24, 32, 3))
    assert developed(radiance * scale) == pytest.approx(developed(radiance), abs=1)


def test_exposure_brightens_and_dark_hand_stays_in_range():
    radiance = RNG.uniform(0.2, 1, (24, 32, 3))
    assert developed(radiance, exposure_ev=1.0).mean() > developed(radiance).mean() + 20
    coverage = np.zeros((24, 32))
    coverage[8:16, 8:24] = 1
    hand = coverage > 0
    dark = np.where(hand[..., None], radiance * 0.01, radiance)
    assert developed(dark, coverage)[hand].mean() > 1.5 * developed(dark)[hand].mean()


def test_each_camera_defect_changes_image_as_expected():
    radiance = np.ones((60, 80, 3))
    radiance[:, 40:] = 0.2
    clean = developed(radiance)
    assert developed(radiance, noise=0.03)[10:50, 5:30].std() > clean[10:50, 5:30].std() + 2
    assert developed(radiance, vignette=0.5)[0, 0].mean() < clean[0, 0].mean() - 10
    for soft in (developed(radiance, blur_px=2.0), developed(radiance, motion_px=5.0)):
        assert np.abs(np.diff(soft[30, :, 1])).max() < 0.7 * np.abs(np.diff(clean[30, :, 1])).max()
    assert developed(radiance, sharpening=0.8, blur_px=1.0)[30].max() > clean[30].max()


def buffers(coverage, specular=0.0, albedo=0.5):
    shape = (*coverage.shape, 3)
    return SkinBuffers(np.full(shape, specular), np.full(shape, albedo), np.full(coverage.shape, 0.5), coverage)


def test_scattering_preserves_uniform_light_and_background():
    coverage = np.zeros((40, 50))
    coverage[5:35, 5:45] = 1
    full = np.full((40, 50, 3), 0.3)
    assert scatter(full, buffers(coverage)) == pytest.approx(full)
    noisy = RNG.uniform(0, 1, full.shape)
    result = scatter(noisy, buffers(coverage))
    assert np.array_equal(result[coverage == 0], noisy[coverage == 0])
    assert np.array_equal(scatter(noisy, buffers(np.zeros((40, 50)))), noisy)


def test_red_light_scatters_farther_than_blue():
    coverage, full = np.ones((81, 81)), np.zeros((81, 81, 3))
    full[40, 40] = 1
    point = scatter(full, buffers(coverage))
    red, green, blue = (point[40, 46, c] / point[40, 40, c] for c in range(3))
    assert red > green > blue
    assert point.sum(axis=(0, 1)) == pytest.approx([1, 1, 1], rel=0.02)


def test_silhouette_oracle_measures_area_of_disk():
    camera = camera_looking_at((0, 0, 0.5), (0, 0, 0), (0, 1, 0), 45.2, 640, 480)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rim = 0.1 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(200)])
    triangles = np.array([(200, i, (i + 1) % 200) for i in range(200)])
    outline = silhouette(camera, np.vstack([rim, np.zeros(3)]), triangles)
    assert outline.sum() == pytest.approx(np.pi * (0.1 * camera.fx / 0.5) ** 2, rel=0.02)
    behind = np.add(np.vstack([rim, np.zeros(3)]), (0, 0, 1))
    assert not silhouette(camera, behind, triangles).any()
