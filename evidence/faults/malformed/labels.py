"""Corruptions of label files of other tools: syntax, missing fields, impossible outlines and run lengths."""

import functools
import json
import operator
import pathlib
import shutil
from random import Random
from typing import Any

from deltasafe.perception.data.importing.import_hands import import_hands
from deltasafe.perception.data.importing.settings import ImportSettings
from evidence.faults.malformed.documents import document_changes, field_changes
from evidence.faults.malformed.files import at, cases_of, edited, file_changes
from evidence.faults.rejection import Case, Change, InputKind, rewrite
from pipelines.home import DATASETS

WIDTH, HEIGHT = 384, 288
OUTLINE = [100, 80, 250, 90, 200, 200]
IMAGE = "hand.jpg"
COCO = {
    "images": [{"id": 1, "file_name": IMAGE, "width": WIDTH, "height": HEIGHT}],
    "categories": [{"id": 1, "name": "hand"}],
    "annotations": [{"id": 7, "image_id": 1, "category_id": 1, "segmentation": [OUTLINE]}],
}
POINTS = [OUTLINE[i : i + 2] for i in (0, 2, 4)]
LABELME = {
    "shapes": [{"label": "hand", "points": POINTS, "shape_type": "polygon"}],
    "imagePath": IMAGE,
    "imageHeight": HEIGHT,
    "imageWidth": WIDTH,
}
REGION = {
    "type": "polygonlabels",
    "original_width": WIDTH,
    "original_height": HEIGHT,
    "value": {"points": [[10, 10], [60, 20], [50, 70]], "polygonlabels": ["hand"]},
}
LABEL_STUDIO = [{"data": {"image": f"/data/upload/1/{IMAGE}"}, "annotations": [{"result": [REGION]}]}]
CVAT = (
    f'<annotations><image id="0" name="{IMAGE}" width="{WIDTH}" height="{HEIGHT}">'
    '<polygon label="hand" points="100,80;250,90;200,200" z_order="0"/></image></annotations>'
)
OUTLINES: dict[str, Any] = {
    "without points": [[]],
    "with two points": [OUTLINE[:4]],
    "with an odd number": [OUTLINE[:5]],
    "of text": [["a", "b", "c", "d", "e", "f"]],
    "of nothing": [[None] * 6],
    "a million pixels away": [[1e9, 0, 1e9, 5, 2e9, 9]],
    "outside the image": [[-50, -50, -10, -50, -10, -10]],
    "run lengths of another size": {"size": [10, 10], "counts": [100]},
    "run lengths too short": {"size": [HEIGHT, WIDTH], "counts": [5, 5]},
    "run lengths too long": {"size": [HEIGHT, WIDTH], "counts": [5, 10**12]},
    "negative run lengths": {"size": [HEIGHT, WIDTH], "counts": [-5, HEIGHT * WIDTH + 5]},
    "run lengths of text": {"size": [HEIGHT, WIDTH], "counts": "not run lengths"},
    "run lengths without counts": {"size": [HEIGHT, WIDTH]},
}


def label_cases(home: pathlib.Path) -> list[Case]:
    """One image with its label, in the formats that are text files."""
    cases = []
    for name, document in (("coco", COCO), ("labelme", LABELME), ("label-studio", LABEL_STUDIO)):
        changes = _with_entries(document)
        if isinstance(document, dict):
            required = [key for key in document if key not in ("imageHeight", "imageWidth")]
            changes |= document_changes() | dict(field_changes(document, required))
            del changes["UTF-16"]  # is read
        cases += _cases(home, name, "labels.json", json.dumps(document), changes)
    return cases + _cases(home, "cvat", "labels.xml", CVAT, _xml_changes())


def _cases(home: pathlib.Path, name: str, file: str, text: str, changes: dict[str, Change]) -> list[Case]:
    valid = home / f"labels {name}"
    valid.mkdir()
    shutil.copyfile(min((DATASETS / "hands" / "train" / "images").iterdir()), valid / IMAGE)
    (valid / file).write_text(text)
    kind = InputKind(
        f"labels of {name}",
        valid,
        lambda given, out: import_hands(given / file, out / "set", ImportSettings(classes=("hand",))),
        lambda given, out: ["hands", "import", str(given / file), str(out / "set"), "--class", "hand"],
    )
    corruptions = {state: at(file, change) for state, change in {**file_changes(), **changes}.items()}
    corruptions["the image is missing"] = edited(file, lambda given: (given / IMAGE).unlink())
    return cases_of(kind, corruptions)


def _with_entries(document: Any) -> dict[str, Change]:
    """Changes of one entry in the lists of a document."""

    def updated(new: dict[str, Any], *place: Any) -> Change:
        def change(path: pathlib.Path, random: Random) -> None:
            changed = json.loads(json.dumps(document))
            entry = functools.reduce(operator.getitem, place, changed)
            entry.update(new)
            rewrite(path, json.dumps(changed).encode())

        return change

    if document is COCO:
        changes = {f"an outline {name}": {"segmentation": outline} for name, outline in OUTLINES.items()}
        return {
            **{name: updated(new, "annotations", 0) for name, new in changes.items()},
            "an unknown category": updated({"category_id": 9}, "annotations", 0),
            "an unknown image": updated({"image_id": 9}, "annotations", 0),
            "a height of text": updated({"height": "high"}, "images", 0),
            "another height": updated({"height": HEIGHT - 1}, "images", 0),
            "a name that is no text": updated({"file_name": None}, "images", 0),
            "an image twice": updated({"images": 2 * COCO["images"]}),
        }
    if document is LABELME:
        return {
            "a shape without points": updated({"points": []}, "shapes", 0),
            "a shape of text": updated({"points": "many"}, "shapes", 0),
            "a mask without pixels": updated(
                {"shape_type": "mask", "points": [[0, 0], [5, 5]], "mask": ""}, "shapes", 0
            ),
            "a line only": updated({"shape_type": "line"}, "shapes", 0),
        }
    region = (0, "annotations", 0, "result", 0)
    return {
        "a turned region": updated({"image_rotation": 90}, *region),
        "a region without a size": updated({"original_width": None}, *region),
        "a truncated brush": updated({"value": {"rle": [0, 0, 0], "brushlabels": ["hand"]}}, *region),
        "a brush of another image": updated({"value": {"rle": [0] * 40, "brushlabels": ["hand"]}}, *region),
        "a task without an image": updated({"data": {"text": "hand"}}, 0),
    }


def _xml_changes() -> dict[str, Change]:
    def replaced(old: str, new: str) -> Change:
        return lambda path, _: rewrite(path, path.read_text().replace(old, new).encode())

    bomb = '<!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;&b;">]><annotations>'
    return {
        "an entity": replaced("<annotations>", bomb),
        "another root": replaced("annotations>", "dataset>"),
        "a track": replaced("</image>", "</image><track/>"),
        "a width of text": replaced(f'width="{WIDTH}"', 'width="wide"'),
        "without a height": replaced(f'height="{HEIGHT}"', ""),
        "points of text": replaced("100,80", "left,top"),
        "two points": replaced(";200,200", ""),
        "without points": replaced('points="100,80;250,90;200,200"', ""),
        "without a label": replaced('label="hand"', ""),
        "a mask of another size": replaced(
            '<polygon label="hand" points="100,80;250,90;200,200"',
            '<mask label="hand" rle="3, 4" left="0" top="0" width="5" height="5"',
        ),
    }
