"""What computes an ensemble's logits: torch, member after member, or the frozen program in one of two runtimes."""

import contextlib
import importlib.util
import pathlib
import threading
from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from deltasafe.errors import ArtifactError, SettingsError

__all__ = ["BACKENDS", "InferenceBackend", "TorchBackend", "backend_of_program", "select_backend"]

BACKENDS = ("auto", "torch", "onnxruntime", "openvino")
_SPIN_US = "50"
_SMALLEST_SIZE = (32, 32)


class InferenceBackend(Protocol):
    """One way of asking all members at once; threads may call it side by side.

    Attributes:
        name: one of `BACKENDS`, not ``auto``.
    """

    name: str

    def member_logits(self, images: NDArray[np.uint8]) -> Tensor:
        """(B, h, w, 3) uint8 at the networks' resolution -> (B, M, h, w) float32."""
        ...


class TorchBackend:
    """The networks themselves, called one after another; the reference, and the only one for a GPU."""

    name = "torch"

    def __init__(self, members: nn.ModuleList, device: torch.device) -> None:
        self.members = members
        self.device = device

    def member_logits(self, images: NDArray[np.uint8]) -> Tensor:
        seen = torch.from_numpy(images).to(self.device).permute(0, 3, 1, 2)
        return torch.stack([network(seen) for network in self.members], dim=1)


def select_backend(name: str, device: torch.device) -> str:
    """``auto`` is ONNX Runtime where it is installed and the device is a CPU, torch otherwise.

    Raises:
        SettingsError: there is no backend of that name, its package is not installed, or it is none for the device.
    """
    if name not in BACKENDS:
        raise SettingsError(f"backend must be one of {BACKENDS}, got {name!r}")
    if name == "auto":
        return "onnxruntime" if device.type == "cpu" and importlib.util.find_spec("onnxruntime") else "torch"
    if name != "torch":
        if device.type != "cpu":
            raise SettingsError(f"backend {name!r} runs on the CPU, not on {device}; use torch there")
        if importlib.util.find_spec(name) is None:
            raise SettingsError(f"backend {name!r} is not installed; pip install {name}, or use another one")
    return name


def backend_of_program(name: str, program: pathlib.Path) -> InferenceBackend:
    """``onnxruntime`` or ``openvino`` with a program that `export_onnx` has written; as many threads as torch."""
    return _OnnxRuntime(program) if name == "onnxruntime" else _OpenVino(program)


@contextlib.contextmanager
def _runnable(program: pathlib.Path, backend: str) -> Iterator[None]:
    """Turns what a runtime raises at a program that it cannot read into one typed error."""
    try:
        yield
    except Exception as error:  # each runtime has kinds of its own
        reason = " ".join(str(error).split())[:200]
        raise ArtifactError(
            program, f"is no program that {backend} can run ({reason}); pull the artifact again"
        ) from error


class _OnnxRuntime:
    name = "onnxruntime"

    def __init__(self, program: pathlib.Path) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        options.inter_op_num_threads = 1
        # threads wait actively from one operation to the next, but no longer: on a machine that does other work as
        # well, such waiting takes time from others and from the thread that is waited for
        options.add_session_config_entry("session.intra_op.spin_duration_us", _SPIN_US)
        options.add_session_config_entry("session.force_spinning_stop", "1")
        with _runnable(program, self.name):
            self._session = onnxruntime.InferenceSession(str(program), options, providers=["CPUExecutionProvider"])
            names = [each.name for each in (*self._session.get_inputs(), *self._session.get_outputs())]
            if names[0] != "rgb" or "member_logits" not in names:
                raise ValueError(f"it maps {names[0]} to {names[1:]}, not rgb to member_logits")

    def member_logits(self, images: NDArray[np.uint8]) -> Tensor:
        return torch.from_numpy(self._session.run(["member_logits"], {"rgb": images})[0])


class _OpenVino:
    name = "openvino"

    def __init__(self, program: pathlib.Path) -> None:
        import openvino

        core = openvino.Core()
        wanted: dict[str, Any] = {
            "PERFORMANCE_HINT": "LATENCY",
            "INFERENCE_NUM_THREADS": torch.get_num_threads(),
            "INFERENCE_PRECISION_HINT": "f32",
        }
        # a request holds the input and output of one inference at a time; with the hint LATENCY all threads of the
        # runtime serve one inference, so that a request per thread would need more memory and save no time
        self._lock = threading.Lock()
        with _runnable(program, self.name):
            self._request = core.compile_model(core.read_model(program), "CPU", wanted).create_infer_request()
            # the first inference of a process initializes OpenVINO's bindings, which deadlocks if two threads do it
            self.member_logits(np.zeros((1, *_SMALLEST_SIZE, 3), np.uint8))

    def member_logits(self, images: NDArray[np.uint8]) -> Tensor:
        with self._lock:
            return torch.from_numpy(self._request.infer({"rgb": images})["member_logits"].copy())
