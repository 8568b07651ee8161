"""Options, printed output and records shared by all evidence commands."""

import argparse
import math
import os
import pathlib
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from deltasafe.compute.progress import Progress
from deltasafe.errors import SettingsError
from pipelines.commands.records import merge_part


def command_parser(module: str, description: str | None, *, seeded: bool = False) -> argparse.ArgumentParser:
    """Create the parser of ``python -m evidence.MODULE`` with the options that all commands share."""
    parser = argparse.ArgumentParser(
        prog=f"python -m evidence.{module}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(module=module)
    parser.add_argument("--record", type=pathlib.Path, metavar="FILE", help="merge the figures into this JSON file")
    if seeded:
        parser.add_argument("--seed", type=int, default=0, help="random seed (default 0)")
    return parser


def named_folder(entry: str) -> tuple[str, pathlib.Path]:
    """Split NAME=FOLDER of an option ``--set``.

    Raises:
        SettingsError: it has another form.
    """
    name, separator, folder = entry.partition("=")
    if not separator or not name.isidentifier():
        raise SettingsError(f"--set must be NAME=FOLDER, with a name of letters, digits and _, got {entry!r}")
    return name, pathlib.Path(folder)


def print_progress(every: int) -> Progress:
    """Create a callback that prints one line per ``every`` items and one for the last item."""

    def progress(done: int, total: int, message: str) -> None:
        if done % every == 0 or done == total:
            print(f"{done} / {total}  {message}", flush=True)

    return progress


def finish(
    options: argparse.Namespace,
    figures: Mapping[str, float],
    failures: Sequence[str] = (),
    *,
    part: str = "",
    command: str = "",
    seeds: Mapping[str, Any] | None = None,
    **details: Any,
) -> int:
    """Print failures and figures, merge them into the record if one is named, and return the exit status.

    Args:
        figures: merged into the ``figures`` of the record, where they replace earlier ones of the same part.
        failures: the exit status is 1 if there are any, else 0; the first 50 are printed.
        part: name of the part of the record; the last component of the module by default.
        command: stored with the part; the command line with its options by default.
        seeds: stored with the part; ``--seed`` by default.
        details: stored with the part; NaN is stored as null.
    """
    for failure in failures[:50]:
        print(f"FAILED  {failure}", file=sys.stderr)
    for name, value in figures.items():
        print(f"{name}: {value:g}")
    if options.record is not None:
        merge_part(
            options.record,
            part or options.module.rpartition(".")[2],
            figures,
            command=command or _command_line(options),
            seeds=seeds if seeds is not None else {"seed": options.seed} if "seed" in options else {},
            load_1min=round(os.getloadavg()[0], 2),
            **_without_nan(details),
        )
        print(f"written: {options.record}")
    return 1 if failures else 0


def _command_line(options: argparse.Namespace) -> str:
    words = [f"python -m evidence.{options.module}"]
    for name, value in vars(options).items():
        if name not in ("module", "record") and value is not None and value is not False:
            words.append(f"--{name.replace('_', '-')}" + ("" if value is True else f" {value}"))
    return " ".join(words)


def _without_nan(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_nan(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(each) for each in value]
    return None if isinstance(value, float) and math.isnan(value) else value
