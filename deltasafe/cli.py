"""Command line: verify, sign, evaluate and use a frozen ensemble; export and import logs for robotics viewers."""

import argparse
import pathlib
import sys

from deltasafe.camera_commands import add_camera_commands
from deltasafe.errors import DataError, DeltasafeError
from deltasafe.hands_commands import add_hands_commands
from deltasafe.import_command import add_import_command
from deltasafe.scene_commands import add_scene_commands


def main(arguments: list[str] | None = None) -> int:
    """Run a command; return 0, or 1 with the reason on standard error: one line, or one and a list of defects."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except DeltasafeError as error:
        reason = "\n- ".join(" ".join(part.split()) for part in str(error).split("\n- "))  # lists are kept
        print(f"deltasafe: {reason}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        print(f"deltasafe: {error.name} is not installed; pip install 'deltasafe[vision]'", file=sys.stderr)
        return 1
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"deltasafe: {place}{error.strerror or error}; free it, or give another place", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="deltasafe", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    path = pathlib.Path

    verify = commands.add_parser("verify", help="check that a frozen ensemble is intact and runs here")
    verify.set_defaults(run=_verify)
    verify.add_argument("folder", type=path, help="folder of the frozen ensemble")
    verify.add_argument("--public-key", type=path, metavar="PEM", help="public key that must verify the signature")

    sign = commands.add_parser("sign", help="sign a frozen ensemble; writes FOLDER.sig beside it")
    sign.set_defaults(run=_sign)
    sign.add_argument("folder", type=path, help="folder of the frozen ensemble")
    sign.add_argument("--key", type=path, metavar="PEM", required=True, help="private key, of curve P-256")

    predict = commands.add_parser("predict", help="write the occupancy probability of an image")
    predict.set_defaults(run=_predict)
    predict.add_argument("folder", type=path, help="folder of the frozen ensemble")
    predict.add_argument("image", type=path, help="image of any size (PNG, JPEG, ...)")
    predict.add_argument(
        "-o",
        "--output",
        type=path,
        help="overlay to write (PNG), beside a 16-bit PNG of the probability "
        "(default: IMAGE.p_occupied.png in the current folder)",
    )
    predict.add_argument("--delta", type=_probability, default=0.05, help="level of the drawn contour (default 0.05)")

    evaluate = commands.add_parser("evaluate", help="evaluate an ensemble on a folder of labeled images")
    evaluate.set_defaults(run=_evaluate)
    evaluate.add_argument("ensemble", type=path, help="folder of the frozen ensemble")
    evaluate.add_argument("folder", type=path, help="labeled images (images/, masks/, optionally ignore/)")
    evaluate.add_argument(
        "-o",
        "--output",
        type=path,
        help="folder to write the report to (default: FOLDER-evaluation in the current one)",
    )
    evaluate.add_argument("--delta", type=_probability, default=0.05, help="delta of planning (default 0.05)")

    export = commands.add_parser("export", help="write an execution or a scene as an MCAP log")
    export.set_defaults(run=_export)
    export.add_argument("folder", type=path, help="folder of an execution (execution.json) or a scene (scene.json)")
    export.add_argument("log", type=path, help="file to write (.mcap)")
    export.add_argument("--scene", type=path, help="folder of the scene of an execution")

    add_import_command(commands)
    add_camera_commands(commands)
    add_scene_commands(commands)
    add_hands_commands(commands)
    return parser


def _probability(text: str) -> float:
    if not 0 < float(text) < 1:
        raise argparse.ArgumentTypeError(f"must lie in (0, 1), got {text}")
    return float(text)


def _verify(options: argparse.Namespace) -> None:
    from deltasafe.perception.artifact.frozen_ensemble import golden_difference, load_ensemble

    folder = options.folder
    if options.public_key is not None:
        from deltasafe.perception.artifact.signature import verify_signature

        verify_signature(folder, options.public_key)
        print(f"{folder}: signed with the private key of {options.public_key}")
    ensemble = load_ensemble(folder)
    difference = golden_difference(ensemble)
    supported = ensemble.calibration.smallest_supported_delta
    print(f"{folder}: {len(ensemble.manifest['files'])} files intact, M = {len(ensemble)}")
    print(f"golden image reproduced within {difference:.1e} in probability")
    print(f"smallest supported delta: {'none' if supported is None else f'{supported:g}'}")


def _sign(options: argparse.Namespace) -> None:
    from deltasafe.perception.artifact.signature import sign_artifact

    print(f"{sign_artifact(options.folder, options.key)}: keep it beside the folder, and distribute both")


def _require_other_place(destination: pathlib.Path, *inputs: pathlib.Path) -> None:
    """Refuse to write over an input, or into a folder that is one.

    Raises:
        DataError: names the destination.
    """
    place = destination.resolve()
    for given in inputs:
        is_same = place.exists() and given.exists() and place.samefile(given)  # a link, too
        if is_same or place.is_relative_to(given.resolve()):
            raise DataError(destination, f"is part of the input {given}; give another file to write")


def _export(options: argparse.Namespace) -> None:
    from deltasafe.execution import Execution
    from deltasafe.interchange import export_execution, export_scene
    from deltasafe.scene import LoggedScene

    folder, log = options.folder, options.log
    if log.suffix.lower() != ".mcap":
        raise DataError(log, "must end in .mcap")
    if (folder / "execution.json").is_file():
        scene = None if options.scene is None else LoggedScene.load(options.scene)
        export_execution(Execution.load(folder), log, scene)
    elif (folder / "scene.json").is_file():
        export_scene(LoggedScene.load(folder), log)
    else:
        raise DataError(folder, "holds neither an execution (execution.json) nor a scene (scene.json)")
    print(f"{log}: {log.stat().st_size / 1e6:.1f} MB")


def _evaluate(options: argparse.Namespace) -> None:
    from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
    from deltasafe.perception.folder_evaluation import evaluate_folder

    def show(done: int, total: int, message: str) -> None:
        if sys.stderr.isatty():
            print(
                f"\r\033[K{done} of {total}: {message}", end="\n" if done == total else "", file=sys.stderr, flush=True
            )

    folder = options.folder.resolve()
    output = options.output or pathlib.Path(f"{folder.name}-evaluation")
    report = evaluate_folder(
        load_ensemble(options.ensemble), folder, output, planning_delta=options.delta, progress=show
    )
    scores, supported = report.final.predictor.scores, report.smallest_supported_delta
    print(
        f"{len(report.image_ids)} images: pixel accuracy {scores.pixel_accuracy:.4f}, mIoU {scores.miou:.4f}, "
        f"NLL {scores.nll:.4f}, Brier score {scores.brier:.4f}; "
        f"smallest supported delta: {'none' if supported is None else f'{supported:g}'}"
    )
    print(f"{output / 'report.md'}: the report\n{output / 'metrics.json'}: its figures, also per image")


def _predict(options: argparse.Namespace) -> None:
    import cv2
    import numpy as np

    from deltasafe.io.images import read_image
    from deltasafe.io.storage import atomic_file
    from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
    from deltasafe.perception.inference.occupancy_overlay import occupancy_overlay
    from deltasafe.perception.settings import PREDICTION_PIXELS

    delta = options.delta
    photo = read_image(options.image, PREDICTION_PIXELS)
    rgb, size = photo.rgb, (photo.rgb.shape[1], photo.rgb.shape[0])
    output = options.output or pathlib.Path(f"{options.image.stem}.p_occupied.png")
    if output.suffix.lower() != ".png":
        raise DataError(output, "must end in .png")
    values = output.with_name(f"{output.stem}.16bit.png")
    for destination in (output, values):
        _require_other_place(destination, options.image, options.folder)
    p_occupied = load_ensemble(options.folder).p_occupied(rgb)
    for destination, pixels in (
        (output, occupancy_overlay(rgb, p_occupied, delta)[..., ::-1]),
        (values, np.round(p_occupied * 65535).astype(np.uint16)),
    ):
        with atomic_file(destination) as temporary:
            temporary.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
    if size != photo.size:
        print(f"{options.image}: scaled down from {photo.size[0]} x {photo.size[1]} to {size[0]} x {size[1]} pixels")
    print(f"{output}: p_occupied > {delta:g} on {float((p_occupied > delta).mean()):.1%} of the image")
    print(f"{values}: the probability, 0..65535 for 0..1")


if __name__ == "__main__":
    sys.exit(main())
