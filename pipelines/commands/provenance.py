"""Provenance of a figure: commit and machine."""

import os
import pathlib
import platform
import subprocess

from pipelines.home import PROJECT


def commit() -> str:
    """Return twelve digits of the commit of the checkout, with `-dirty` if files were changed."""
    command = ["git", "-C", str(PROJECT), "describe", "--always", "--dirty", "--abbrev=12", "--exclude", "*"]
    finished = subprocess.run(command, capture_output=True, text=True, check=False)
    return finished.stdout.strip() or "not a git checkout"


def machine() -> str:
    """Describe the machine: cores, processor, GPU, versions of Python and torch."""
    import torch

    cpu = platform.processor() or platform.machine()
    info = pathlib.Path("/proc/cpuinfo")
    if info.is_file():
        names = [line.split(":")[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = names[0] if names else cpu
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else "no GPU"
    return f"{os.cpu_count()} cores, {cpu}, {gpu}; Python {platform.python_version()}, torch {torch.__version__}"
