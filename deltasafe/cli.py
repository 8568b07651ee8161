"""A frozen ensemble on the command line (`verify`, `sign`, `predict`), and logs for robotics viewers."""

import argparse
import pathlib
import sys

from deltasafe.errors import DataError, DeltasafeError

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> int:
    """Entry point; 0 on success, 1 with one line on standard error where an input is unusable."""
    parser = argparse.ArgumentParser(prog="deltasafe", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    verify = commands.add_parser("verify", help="check that a frozen ensemble is intact and works here")
    verify.add_argument("folder", type=pathlib.Path, help="folder of the frozen ensemble")
    verify.add_argument("--public-key", type=pathlib.Path, metavar="PEM", help="of whoever must have signed it")
    sign = commands.add_parser("sign", help="sign a frozen ensemble; writes FOLDER.sig beside it")
    sign.add_argument("folder", type=pathlib.Path, help="folder of the frozen ensemble")
    sign.add_argument("--key", type=pathlib.Path, metavar="PEM", required=True, help="private key, of curve P-256")
    predict = commands.add_parser("predict", help="write the occupancy probability of an image")
    predict.add_argument("folder", type=pathlib.Path, help="folder of the frozen ensemble")
    predict.add_argument("image", type=pathlib.Path, help="picture of any size (PNG, JPEG, ...)")
    predict.add_argument(
        "-o",
        "--output",
        type=pathlib.Path,
        help="overlay to write (PNG); beside it a 16-bit PNG of the probability itself "
        "(default: IMAGE.p_occupied.png in the current folder)",
    )
    predict.add_argument("--delta", type=float, default=0.05, help="threshold that is outlined (default 0.05)")
    export = commands.add_parser("export", help="write an execution or a scene as an MCAP log")
    export.add_argument(
        "folder", type=pathlib.Path, help="folder of an execution (execution.json) or a scene (scene.json)"
    )
    export.add_argument("log", type=pathlib.Path, help="file to write (.mcap)")
    export.add_argument("--scene", type=pathlib.Path, help="folder of the scene around an execution")
    importing = commands.add_parser("import", help="turn an MCAP log of a scene into its folder")
    importing.add_argument("log", type=pathlib.Path, help="file to read (.mcap)")
    importing.add_argument("folder", type=pathlib.Path, help="folder to write")
    options = parser.parse_args(arguments)
    try:
        if options.command == "verify":
            _verify(options.folder, options.public_key)
        elif options.command == "sign":
            _sign(options.folder, options.key)
        elif options.command == "export":
            _export(options.folder, options.log, options.scene)
        elif options.command == "import":
            _import(options.log, options.folder)
        else:
            if not 0 < options.delta < 1:
                parser.error(f"--delta must lie in (0, 1), got {options.delta}")
            _predict(options.folder, options.image, options.output, options.delta)
    except DeltasafeError as error:
        print(f"deltasafe: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"deltasafe: {place}{error.strerror or error}; free it, or give another place", file=sys.stderr)
        return 1
    return 0


def _verify(folder: pathlib.Path, public_key: pathlib.Path | None) -> None:
    from deltasafe.perception.artifact.frozen_ensemble import golden_difference, load_ensemble

    if public_key is not None:
        from deltasafe.perception.artifact.signature import verify_signature

        verify_signature(folder, public_key)
        print(f"{folder}: signed with the private half of {public_key}")
    ensemble = load_ensemble(folder)
    difference = golden_difference(ensemble)
    files = len(ensemble.manifest["files"])
    supported = ensemble.calibration.smallest_supported_delta
    print(f"{folder}: {files} files intact, M = {len(ensemble)}")
    print(f"golden image answered within {difference:.1e} in probability")
    print(f"smallest supported delta: {'none' if supported is None else f'{supported:g}'}")


def _sign(folder: pathlib.Path, key: pathlib.Path) -> None:
    from deltasafe.perception.artifact.signature import sign_artifact

    print(f"{sign_artifact(folder, key)}: belongs beside the folder; pass on both")


def _export(folder: pathlib.Path, log: pathlib.Path, around: pathlib.Path | None) -> None:
    from deltasafe.execution import Execution
    from deltasafe.interchange import export_execution, export_scene
    from deltasafe.scene import LoggedScene

    if (folder / "execution.json").is_file():
        export_execution(Execution.load(folder), log, None if around is None else LoggedScene.load(around))
    elif (folder / "scene.json").is_file():
        export_scene(LoggedScene.load(folder), log)
    else:
        raise DataError(folder, "holds neither an execution (execution.json) nor a scene (scene.json)")
    print(f"{log}: {log.stat().st_size / 1e6:.1f} MB")


def _import(log: pathlib.Path, folder: pathlib.Path) -> None:
    from deltasafe.interchange import import_scene

    print(f"{folder}: {import_scene(log, folder).id}")


def _predict(folder: pathlib.Path, image: pathlib.Path, output: pathlib.Path | None, delta: float) -> None:
    import cv2
    import numpy as np

    from deltasafe.io.storage import atomic_file
    from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
    from deltasafe.perception.data.labeled_images import read_rgb
    from deltasafe.perception.inference.occupancy_overlay import occupancy_overlay

    rgb = read_rgb(image)
    output = output or pathlib.Path(f"{image.stem}.p_occupied.png")
    if output.suffix.lower() != ".png":
        raise DataError(output, "must end in .png")
    p_occupied = load_ensemble(folder).p_occupied(rgb)
    values = output.with_name(f"{output.stem}.16bit.png")
    for destination, pixels in (
        (output, occupancy_overlay(rgb, p_occupied, delta)[..., ::-1]),
        (values, np.round(p_occupied * 65535).astype(np.uint16)),
    ):
        with atomic_file(destination) as temporary:
            temporary.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
    share = float((p_occupied > delta).mean())
    print(f"{output}: p_occupied > {delta:g} on {share:.1%} of the picture")
    print(f"{values}: the probability itself, 0..65535 for 0..1")


if __name__ == "__main__":
    sys.exit(main())
