"""Commands about labeled images: ``deltasafe hands import``."""

import argparse
import dataclasses
import pathlib


def add_hands_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the commands about labeled images."""
    from deltasafe.perception.data.importing.settings import FORMATS, RECTANGLES

    hands = commands.add_parser("hands", help="prepare labeled images").add_subparsers(required=True, metavar="ACTION")
    importing = hands.add_parser("import", help="convert the labels of other tools to a set of images and masks")
    importing.set_defaults(run=_import_hands)
    importing.add_argument("source", type=pathlib.Path, help="label file, or folder with labels and images")
    importing.add_argument("folder", type=pathlib.Path, help="folder to write")
    add = importing.add_argument
    add("--format", choices=FORMATS, default="auto", help="of the source (default: recognized by its files)")
    add(
        "--class",
        dest="classes",
        action="append",
        default=[],
        metavar="NAME",
        help="class that is the obstacle, also a gray value (255) or color (#ff0000) of masks without names; "
        "several are merged, '*' takes all",
    )
    add(
        "--obstacle",
        default="",
        metavar="NAME",
        help="what the classes are (default: hand, or their names)",
    )
    add("--threshold", type=float, default=0.0, help="of soft masks: fraction of full scale from which it is obstacle")
    add("--alpha", action="store_true", help="the alpha channel of the mask files is the mask")
    add("--inverted", action="store_true", help="the mask files mark the background")
    add("--large-masks", action="store_true", help="masks that cover most of an image are right")
    add("--rectangles", choices=RECTANGLES, default="refuse", help="boxes of the obstacle (default: skip such images)")
    add("--keep-unlabeled", action="store_true", help="images without annotations show no obstacle, instead of skipped")
    add("--images", default="", metavar="FOLDER", help="folder of the images (default: searched below the source)")
    add("--masks", default="", metavar="FOLDER", help="folder of the masks (format folder)")
    add(
        "--masks-drawn-on",
        choices=("upright", "stored"),
        default="",
        help="of photographs with an EXIF orientation: the picture as viewers show it, or the stored pixels",
    )


def _import_hands(options: argparse.Namespace) -> None:
    from deltasafe.perception.data.importing.import_hands import import_hands
    from deltasafe.perception.data.importing.settings import ImportSettings

    values = {field.name: getattr(options, field.name) for field in dataclasses.fields(ImportSettings)}
    settings = ImportSettings(**{**values, "classes": tuple(options.classes)})
    report = import_hands(options.source, options.folder, settings)
    for image in report.skipped:
        print(f"skipped {image.source}: {image.reason}")
    print(f"{options.folder}: {report.summary()}")
    print(f"{options.folder / report.SHEET}: every mask over its image; {options.folder / report.TABLE}: the table")
