"""Walk through docs/how-to/own-camera.md, from a printed board to a plan beside a coffee cup, as a user would.

Board and cups are drawn by OpenCV. Every step is a command: labels are converted from COCO, an ensemble is trained, a
camera is located, a scene is made from one photograph without ground truth, and its motion is planned and executed.
No page may say hand, and none may claim anything about contacts with the cup.
"""

import os
import pathlib
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.cameras.board import Board
from deltasafe.cameras.calibration_files import read_camera
from deltasafe.io.storage import read_json
from evidence.board_images import Lens, View, look_at, render_board
from evidence.drawn_cups import Cup, draw_cup, write_backgrounds, write_coco
from evidence.reporting import command_parser, finish
from pipelines.home import PROJECT

BOARD, BOARD_ORIGIN = "charuco:7x5:0.030:0.022", (-0.105, -0.075, 0.0, 0.0)
START, GOAL, HEIGHT_M = "-0.13 -0.09 0.03 0", "0.13 0.09 0.03 0", "0.09"
_LENS = Lens(
    (640, 480), np.array([[560.0, 0, 322.0], [0, 560.0, 238.0], [0, 0, 1.0]]), np.array([-0.12, 0.05, 0.0, 0.0, 0.0])
)
_MAX_ERROR_M = 0.005
_HAND = re.compile(r"\bhands?\b(?!-)", re.IGNORECASE)


def walk(folder: pathlib.Path, run: Callable[[str, str], None], n_train: int = 50, n_test: int = 12) -> list[str]:
    """Do all steps in ``folder``; return what went wrong, empty if the walk passed.

    Args:
        folder: for all files; the results are below ``home``.
        run: runs a command, given its module and its words.
        n_train, n_test: number of photographs to draw.
    """
    rng, view = np.random.default_rng(0), look_at(np.zeros(3), 0.55, 0.12, 0.4, 0.1)
    train, test = (write_coco(folder / name, n, seed) for name, n, seed in (("train", n_train, 1), ("test", n_test, 2)))
    backgrounds = write_backgrounds(folder / "tables", 6, 3)
    _write_png(folder / "board.png", render_board(Board.parse(BOARD), _LENS, view, BOARD_ORIGIN, rng))
    _write_png(folder / "photo.png", draw_cup(Cup(0.0, 0.0), _LENS, view, rng)[0])
    _write_calibration(folder / "calibration.yaml")
    origin, scene = " ".join(map(str, BOARD_ORIGIN)), folder / "scenes" / "cup"
    run("deltasafe.cli", f"camera board --board {BOARD} -o {folder}/board.pdf")
    run(
        "deltasafe.cli",
        f"camera locate {folder}/board.png --camera {folder}/calibration.yaml --board {BOARD} --board-origin {origin} "
        f"-o {folder}/camera.json",
    )
    run(
        "deltasafe.cli",
        f"scene new {scene} --image {folder}/photo.png --camera {folder}/camera.json --hand-height {HEIGHT_M} "
        f"--start {START} --goal {GOAL}",
    )
    run(
        "pipelines.commands.demo",
        f"--hands {train} --test {test} --scenes {scene.parent} --backgrounds {backgrounds}",
    )
    home = folder / "home" / "own-data" / "coffee_cup"
    (frozen,) = (home / "frozen").glob("ensemble-*")
    (tested,) = (path for path in (folder / "home" / "own-data" / "converted").iterdir() if _size(path) == n_test)
    run("deltasafe.cli", f"evaluate {frozen} {tested} -o {folder}/evaluation")
    return [*_problems_of_the_camera(folder, view), *_problems_of_the_report(home), *_pages_that_say_hand(folder)]


class _Runner:
    """Runs commands of the project with a home and a preset; a command that fails ends the walk."""

    def __init__(self, folder: pathlib.Path, preset: str) -> None:
        self.environment = {**os.environ, "DELTASAFE_HOME": str(folder / "home"), "DELTASAFE_PRESET": preset}
        self.environment["PYTHONPATH"] = str(PROJECT)

    def __call__(self, module: str, words: str) -> None:
        print(f"$ {module} {words}", flush=True)
        command = [sys.executable, "-m", module, *words.split()]
        subprocess.run(command, env=self.environment, cwd=PROJECT, check=True)


def _problems_of_the_camera(folder: pathlib.Path, view: View) -> Iterator[str]:
    found_m = read_camera(folder / "camera.json").pinhole().position_m
    error_m = float(np.linalg.norm(found_m - view.position_m))
    print(f"the camera was located within {1000 * error_m:.1f} mm")
    if error_m > _MAX_ERROR_M:
        yield f"the camera was located {1000 * error_m:.1f} mm from its place"


def _problems_of_the_report(home: pathlib.Path) -> Iterator[str]:
    (report,) = (home / "store" / "safety_report").glob("*/report.md")
    figures, text = read_json(report.with_name("report.json"))["figures"], report.read_text(encoding="utf-8")
    if figures["scenes_executed"] != 1 or figures["scenes_completed"] != 1:
        yield f"the motion was not executed: {text[:400]}"
    if figures["contacts"] is not None or figures["scenes_judged"] != 0 or figures["scenes_safe"] != 0:
        yield f"the report judges contacts without ground truth: {figures}"
    if "Contacts with the coffee cup are not judged" not in text:
        yield "the report does not say that contacts are not judged"


def _pages_that_say_hand(folder: pathlib.Path) -> Iterator[str]:
    for page, text in [*_markdown(folder), *_events(folder / "home" / "own-data" / "coffee_cup")]:
        for found in _HAND.finditer(text):
            yield f"{page} says hand: ...{text[max(0, found.start() - 60) : found.end() + 40]!r}"


def _markdown(folder: pathlib.Path) -> Iterator[tuple[str, str]]:
    for page in sorted(folder.rglob("*.md")):
        yield page.relative_to(folder).as_posix(), page.read_text(encoding="utf-8")


def _events(home: pathlib.Path) -> Iterator[tuple[str, str]]:
    """Yield what the UI shows: names and texts of the metadata of all assets and checks, and their descriptions."""
    import dagster as dg

    from pipelines.build import build_defs

    definitions = build_defs(home)
    chain = {key.to_user_string() for key in definitions.resolve_job_def("everything").asset_layer.selected_asset_keys}
    for spec in definitions.resolve_all_asset_specs():
        if spec.key.to_user_string() in chain:
            yield f"description of {spec.key.to_user_string()}", spec.description or ""
    with dg.DagsterInstance.from_config(str(home / "dagster")) as instance:
        (run,) = instance.get_runs()
        for event in (entry.dagster_event for entry in instance.all_logs(run.run_id) if entry.dagster_event):
            if event.is_step_materialization:
                shown = event.step_materialization_data.materialization
                yield f"page of {event.asset_key}", _text(shown.metadata)
            elif event.event_type == dg.DagsterEventType.ASSET_CHECK_EVALUATION:
                check = event.asset_check_evaluation_data
                yield f"check {check.check_name}", f"{check.description} {_text(check.metadata)}"


def _text(metadata: object) -> str:
    """Return names and values without the pictures that they inline, and without the paths of folders."""
    assert isinstance(metadata, dict)
    shown = " ".join(f"{name}: {getattr(value, 'value', value)}" for name, value in metadata.items())
    return re.sub(r"/\S+|data:image\S+", "", shown)


def _size(folder: pathlib.Path) -> int:
    return sum(1 for _ in (folder / "images").iterdir())


def _write_calibration(path: pathlib.Path) -> None:
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", _LENS.size[0])
    file.write("image_height", _LENS.size[1])
    file.write("camera_matrix", _LENS.matrix)
    file.write("distortion_coefficients", _LENS.distortion[None])
    file.release()


def _write_png(path: pathlib.Path, rgb: NDArray[np.uint8]) -> None:
    path.write_bytes(cv2.imencode(".png", rgb[..., ::-1])[1].tobytes())


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.own_camera``."""
    parser = command_parser("own_camera", __doc__)
    parser.add_argument("--preset", default="smoke", help="of the training (default smoke)")
    parser.add_argument("--out", type=pathlib.Path, help="new folder to keep (default: a temporary one)")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        folder = (options.out or pathlib.Path(temporary) / "walk").absolute()
        folder.mkdir(parents=True)
        failures = walk(folder, _Runner(folder, options.preset))
    return finish(options, {"walk_passed": float(not failures)}, failures)


if __name__ == "__main__":
    sys.exit(main())
