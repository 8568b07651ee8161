"""JSON records of figures that several commands share."""

import pathlib
from collections.abc import Mapping
from typing import Any

from deltasafe.io.storage import read_json, write_json
from pipelines.commands.provenance import commit, machine


def merge_part(
    destination: str | pathlib.Path,
    name: str,
    figures: Mapping[str, float],
    *,
    command: str,
    seeds: Mapping[str, Any],
    **about: Any,
) -> None:
    """Merge the figures of one command into a JSON record; figures of other commands stay.

    Args:
        destination: file with the ``figures`` of all commands, and under ``parts`` the record of each command.
        name: name of the part; its earlier figures are replaced.
        command: the command line.
        seeds: random seeds of the command.
        about: other facts about the part.
    """
    destination = pathlib.Path(destination)
    earlier = read_json(destination) if destination.is_file() else {}
    parts = earlier.get("parts", {})
    replaced = parts.get(name, {}).get("figures", {})
    kept = {key: value for key, value in earlier.get("figures", {}).items() if key not in replaced}
    part = {
        **about,
        "figures": dict(figures),
        "command": command,
        "seeds": dict(seeds),
        "commit": commit(),
        "machine": machine(),
    }
    parts = {**parts, name: part}
    write_json(
        destination,
        {
            **earlier,
            "figures": kept | part["figures"],
            "command": "; ".join(each["command"] for _, each in sorted(parts.items())),
            "seeds": {key: each["seeds"] for key, each in parts.items()},
            "commit": part["commit"],
            "machine": part["machine"],
            "parts": parts,
        },
    )
