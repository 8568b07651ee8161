"""That the benchmarks run, count rightly and keep each other's records; what they measure is not tested here."""

import math

import numpy as np
import pytest
import torch

from deltasafe.perception.augmentation import AugmentationSettings
from deltasafe.perception.augmented_set import write_augmented_set
from deltasafe.perception.hands import HandSet
from deltasafe.presets import PRESETS
from deltasafe.storage import read_json
from evidence.benchmarks import inference, paper_preset, training
from evidence.benchmarks.flops import training_flops
from evidence.benchmarks.measuring import conclude
from evidence.benchmarks.plain_training import PngHands, write_pngs
from evidence.benchmarks.training import images_per_s_in_turn, images_per_s_side_by_side
from pipelines.home import DATASETS


def test_all_figures_are_finite_and_come_into_one_record(tmp_path):
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
    assert highest - lowest > 0.1, "agreement on a constant says nothing"


def test_a_record_keeps_what_others_measured_and_drops_what_is_measured_anew(tmp_path):
    record = tmp_path / "record.json"
    command = "python -m evidence.benchmarks.one"
    conclude({"figures": {"a": 1.0, "old": 2.0}, "seeds": {"x": 0}}, record, f"{command} --repeats 3")
    conclude({"figures": {"b": 3.0}, "cores": float("nan")}, record, "python -m evidence.benchmarks.two")
    conclude({"figures": {"a": 4.0}, "seeds": {"x": 1}}, record, "python -m evidence.benchmarks.one")
    written = read_json(record)
    assert written["figures"] == {"a": 4.0, "b": 3.0}
    assert written["seeds"] == {"one": {"x": 1}, "two": {}}
    assert written["command"] == "python -m evidence.benchmarks.one; python -m evidence.benchmarks.two"
    assert written["parts"]["two"]["cores"] is None
    assert written["commit"]
    assert written["machine"]


def test_only_time_in_which_all_members_train_is_counted():
    # steps of 1 s beside the other, of 0.25 s alone: before 10 and after 20 is not a measurement
    early = [8.0, 8.25, 8.5, 8.75, *np.arange(9.0, 21.0)]
    late = [*np.arange(10.0, 21.0), 20.25, 20.5, 20.75]
    assert images_per_s_side_by_side({"early": early, "late": late}, 8) == pytest.approx(16.0)
    with pytest.raises(ValueError, match="more --steps"):
        images_per_s_side_by_side({"early": [0.0, 1.0], "late": [5.0, 6.0]}, 8)


def test_members_in_turn_are_counted_from_their_first_step_on():
    assert images_per_s_in_turn({"0": [3.0, 4.0, 5.0], "1": [100.0, 103.0, 104.0]}, 6) == pytest.approx(4 * 6 / 6.0)


@pytest.mark.parametrize("groups", [1, 4, 16])
def test_operations_of_a_convolution_are_counted_as_in_closed_form(groups):
    class Two(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.first = torch.nn.Conv2d(3, 16, 1, bias=False)
            self.second = torch.nn.Conv2d(16, 16, 3, padding=1, groups=groups, bias=False)

        def forward(self, images):
            return self.second(self.first(images)).mean(dim=1)

    first, second = 2 * 16 * 3 * 8 * 10, 2 * 16 * (16 // groups) * 9 * 8 * 10
    # nobody asks for the gradient of the image
    assert training_flops(Two(), 8, 10) == 2 * first + 3 * second


def test_projected_cost_is_steps_times_time():
    found = paper_preset.projection(1000, PRESETS["paper"], step_s=3.6, flops_an_image=6e11, gpu_tflop_per_s=10.0)
    assert found["paper_preset_projected_steps"] == 15_000
    assert found["paper_preset_projected_cpu_hours"] == pytest.approx(15.0)
    assert found["paper_preset_projected_gpu_hours"] == pytest.approx(30_000 * 0.06 / 3600)


def test_the_plain_loop_sees_the_same_images(tmp_path):
    hands = HandSet.load(DATASETS / "hands" / "train")
    two = type(hands)(hands.name, hands.items[:2], hands.pixel_digests[:2], hands.digest)
    settings = AugmentationSettings(n_variants=1, width=64, height=48, supersampling=1)
    data = write_augmented_set(two, None, settings, tmp_path / "set", workers=1)
    write_pngs(data, tmp_path / "png")
    pngs = PngHands(tmp_path / "png")
    assert len(pngs) == 2
    for i in range(2):
        image, label = pngs[i]
        assert image.is_contiguous()
        assert np.array_equal(image.permute(1, 2, 0).numpy(), data.images[i])
        assert np.array_equal(label.numpy(), data.labels(np.array([i]))[0])
