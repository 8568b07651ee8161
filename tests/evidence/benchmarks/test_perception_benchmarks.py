"""The perception benchmarks run and compute their figures correctly; the measured times are not tested."""

import math

import numpy as np
import pytest
import torch

from deltasafe.io.storage import read_json
from deltasafe.perception.data.augmentation import AugmentationSettings
from deltasafe.perception.data.augmented_set import augment_images
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.presets import PRESETS
from evidence.benchmarks import inference, paper_preset, training
from evidence.benchmarks.flops import training_flops
from evidence.benchmarks.plain_training import PngHands, write_pngs
from evidence.benchmarks.training import parallel_images_per_s, sequential_images_per_s
from pipelines.home import DATASETS


def test_figures_are_finite_and_merged_into_one_record(tmp_path):
    record = tmp_path / "benchmarks.json"
    common = ["--tiny", "--record", str(record)]
    assert inference.main([*common, "--members", "2", "--threads", "1", "--repeats", "1"]) == 0
    assert training.main([*common, "--members", "1", "--steps", "2", "--repeats", "1"]) == 0
    assert paper_preset.main([*common, "--images", "6"]) == 0
    written = read_json(record)
    assert set(written["parts"]) == {"inference", "training", "paper_preset"}
    figures = written["figures"]
    assert {"inference_ratio", "inference_ratio_48x36", "training_ratio", "training_ratio_recipe"} <= set(figures)
    assert {"training_peak_share", "paper_preset_s_per_step", "paper_preset_projected_gpu_hours"} <= set(figures)
    assert all(math.isfinite(value) for value in figures.values())
    assert all(value > 0 for name, value in figures.items() if "agreement" not in name)
    assert figures["inference_agreement"] <= 1e-4
    lowest, highest = written["parts"]["inference"]["sizes"]["64x48"]["range_of_p_occupied"]
    assert highest - lowest > 0.1, "agreement on a constant image proves nothing"


def test_parallel_rate_counts_time_in_which_all_members_train():
    # steps take 1 s while both train, and 0.25 s alone (before 10 s and after 20 s)
    early = [8.0, 8.25, 8.5, 8.75, *np.arange(9.0, 21.0)]
    late = [*np.arange(10.0, 21.0), 20.25, 20.5, 20.75]
    assert parallel_images_per_s({"early": early, "late": late}, 8) == pytest.approx(16.0)
    with pytest.raises(ValueError, match="more --steps"):
        parallel_images_per_s({"early": [0.0, 1.0], "late": [5.0, 6.0]}, 8)


def test_sequential_rate_leaves_out_the_first_step():
    assert sequential_images_per_s({"0": [3.0, 4.0, 5.0], "1": [100.0, 103.0, 104.0]}, 6) == pytest.approx(4 * 6 / 6.0)


@pytest.mark.parametrize("groups", [1, 4, 16])
def test_convolution_flops_match_closed_form(groups):
    class Two(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.first = torch.nn.Conv2d(3, 16, 1, bias=False)
            self.second = torch.nn.Conv2d(16, 16, 3, padding=1, groups=groups, bias=False)

        def forward(self, images):
            return self.second(self.first(images)).mean(dim=1)

    first, second = 2 * 16 * 3 * 8 * 10, 2 * 16 * (16 // groups) * 9 * 8 * 10
    # the gradient of the image is not computed
    assert training_flops(Two(), 8, 10) == 2 * first + 3 * second


def test_projection_is_steps_times_time():
    found = paper_preset.projection(1000, PRESETS["paper"], step_s=3.6, flops_per_image=6e11, gpu_tflop_per_s=10.0)
    assert found["paper_preset_projected_steps"] == 15_000
    assert found["paper_preset_projected_cpu_hours"] == pytest.approx(15.0)
    assert found["paper_preset_projected_gpu_hours"] == pytest.approx(30_000 * 0.06 / 3600)


def test_png_dataset_equals_augmented_set(tmp_path):
    hands = LabeledImageSet.load(DATASETS / "hands" / "train")
    two = type(hands)(hands.name, hands.items[:2], hands.pixel_digests[:2], hands.digest)
    settings = AugmentationSettings(n_variants=1, width=64, height=48, supersampling=1)
    data = augment_images(two, tmp_path / "set", settings, workers=1)
    write_pngs(data, tmp_path / "png")
    pngs = PngHands(tmp_path / "png")
    assert len(pngs) == 2
    for i in range(2):
        image, label = pngs[i]
        assert image.is_contiguous()
        assert np.array_equal(image.permute(1, 2, 0).numpy(), data.images[i])
        assert np.array_equal(label.numpy(), data.labels(np.array([i]))[0])
