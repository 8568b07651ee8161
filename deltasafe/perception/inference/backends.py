"""Inference backends: the networks in torch, or the frozen ONNX program in ONNX Runtime or OpenVINO."""

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

BACKENDS = ("auto", "torch", "onnxruntime", "openvino")
_SPIN_US = "50"
_SMALLEST_SIZE = (32, 32)


class InferenceBackend(Protocol):
    """Computes the logits of all members; thread-safe.

    Attributes:
        name: one of `BACKENDS`, except ``auto``.
    """

    name: str

    def member_logits(self, images: NDArray[np.uint8]) -> Tensor:
        """Return logits (B, M, h, w), float32, of images (B, h, w, 3), uint8, at the networks' resolution."""
        ...


class TorchBackend:
    """Runs the networks one after another. It is the reference for the other backends, and the only one for GPUs."""

    name = "torch"

    def __init__(self, members: nn.ModuleList, device: torch.device) -> None:
        self.members = members
        self.device = device

    def member_logits(self, images: NDArray[np.uint8]) -> Tensor:
        batch = torch.from_numpy(images).to(self.device).permute(0, 3, 1, 2)
        return torch.stack([network(batch) for network in self.members], dim=1)


def select_backend(name: str, device: torch.device) -> str:
    """Return the backend to use: ``auto`` is ONNX Runtime on a CPU if it is installed, else torch.

    Raises:
        SettingsError: the backend is unknown, not installed, or does not run on ``device``.
    """
    if name not in BACKENDS:
        raise SettingsError(f"backend must be one of {BACKENDS}, got {name!r}")
    if name == "auto":
        return "onnxruntime" if device.type == "cpu" and importlib.util.find_spec("onnxruntime") else "torch"
    if name != "torch":
        if device.type != "cpu":
            raise SettingsError(f"backend {name!r} runs on the CPU only, not on {device}; use torch")
        if importlib.util.find_spec(name) is None:
            raise SettingsError(f"backend {name!r} is not installed; pip install {name}, or use another backend")
    return name


def load_program(backend: str, program: pathlib.Path) -> InferenceBackend:
    """Load a program of `export_onnx` into ``onnxruntime`` or ``openvino``, with as many threads as torch has.

    Raises:
        ArtifactError: the runtime cannot load the program.
    """
    return _OnnxRuntime(program) if backend == "onnxruntime" else _OpenVino(program)


@contextlib.contextmanager
def _load_errors(program: pathlib.Path, backend: str) -> Iterator[None]:
    """Translate every exception to an `ArtifactError`: each runtime raises types of its own."""
    try:
        yield
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise ArtifactError(program, f"cannot be loaded by {backend} ({reason}); pull the artifact again") from error


class _OnnxRuntime:
    name = "onnxruntime"

    def __init__(self, program: pathlib.Path) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        options.inter_op_num_threads = 1
        # limits busy waiting between operations: on a loaded machine it takes CPU time from the thread that is awaited
        options.add_session_config_entry("session.intra_op.spin_duration_us", _SPIN_US)
        options.add_session_config_entry("session.force_spinning_stop", "1")
        with _load_errors(program, self.name):
            self._session = onnxruntime.InferenceSession(str(program), options, providers=["CPUExecutionProvider"])
            names = [each.name for each in (*self._session.get_inputs(), *self._session.get_outputs())]
            if names[0] != "rgb" or "member_logits" not in names:
                raise ValueError(f"its input is {names[0]}, not rgb, or no output of {names[1:]} is member_logits")

    def member_logits(self, images: NDArray[np.uint8]) -> Tensor:
        return torch.from_numpy(self._session.run(["member_logits"], {"rgb": images})[0])


class _OpenVino:
    name = "openvino"

    def __init__(self, program: pathlib.Path) -> None:
        import openvino

        core = openvino.Core()
        options: dict[str, Any] = {
            "PERFORMANCE_HINT": "LATENCY",
            "INFERENCE_NUM_THREADS": torch.get_num_threads(),
            "INFERENCE_PRECISION_HINT": "f32",
        }
        # one request with a lock: a request holds input and output of one inference, so threads cannot share it; with
        # the hint LATENCY one inference uses all threads, so a request per thread would save no time
        self._lock = threading.Lock()
        with _load_errors(program, self.name):
            self._request = core.compile_model(core.read_model(program), "CPU", options).create_infer_request()
            # the first inference of a process initializes OpenVINO's bindings, which deadlocks if two threads do it
            self.member_logits(np.zeros((1, *_SMALLEST_SIZE, 3), np.uint8))

    def member_logits(self, images: NDArray[np.uint8]) -> Tensor:
        with self._lock:
            return torch.from_numpy(self._request.infer({"rgb": images})["member_logits"].copy())
