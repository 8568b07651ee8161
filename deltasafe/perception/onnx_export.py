"""The whole ensemble as one ONNX program: an image in, the (recalibrated) mean and each member's probability out."""

import logging
import pathlib
import warnings

import torch
from torch import Tensor, nn

from deltasafe.perception.ensemble import Ensemble, probability
from deltasafe.perception.metrics import NLL_CLIP
from deltasafe.storage import atomic_file

__all__ = ["export_onnx"]


class _Program(nn.Module):
    """uint8 (B, h, w, 3) at the inference size -> p_occupied (B, h, w) and member_p_occupied (B, M, h, w)."""

    def __init__(self, ensemble: Ensemble) -> None:
        super().__init__()
        self.members = ensemble.members
        self.temperature = ensemble.temperature

    def forward(self, rgb: Tensor) -> tuple[Tensor, Tensor]:
        images = rgb.permute(0, 3, 1, 2).float()
        each = [probability(network(images), tuple(images.shape[-2:])) for network in self.members]
        stacked = torch.stack(each, dim=1)
        mean = stacked.mean(dim=1)
        if self.temperature != 1.0:
            mean = torch.sigmoid(torch.logit(mean, eps=NLL_CLIP) / self.temperature)
        return mean, stacked


def export_onnx(ensemble: Ensemble, destination: pathlib.Path) -> None:
    """Write ``ensemble`` for images of its inference size (any batch); the file is free of machine paths."""
    import onnx

    settings = ensemble.settings
    height, width = settings.network_size(settings.height, settings.width)
    example = torch.zeros((2, height, width, 3), dtype=torch.uint8)
    level = logging.getLogger("torch.onnx").level
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), torch.inference_mode(False), torch.no_grad():
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                _Program(ensemble).eval(),
                (example,),
                input_names=["rgb"],
                output_names=["p_occupied", "member_p_occupied"],
                dynamic_shapes=({0: torch.export.Dim("batch", min=1, max=1024)},),
                dynamo=True,
                verbose=False,
            )
    finally:
        logging.getLogger("torch.onnx").setLevel(level)
    assert program is not None
    model = program.model_proto
    for node in model.graph.node:
        del node.metadata_props[:]  # stack traces of the exporting machine
    for value in [*model.graph.value_info, *model.graph.input, *model.graph.output, *model.graph.initializer]:
        del value.metadata_props[:]
    del model.graph.metadata_props[:]
    del model.metadata_props[:]
    for function in model.functions:
        del function.metadata_props[:]
        for node in function.node:
            del node.metadata_props[:]
    with atomic_file(destination) as temporary:
        onnx.save(model, temporary)
