"""Write the label files of this folder with the tools themselves, and the masks that the tools read back from them.

Needs two environments, whose packages conflict: ``pip install datumaro==1.13.12``, then
``pip install labelme==6.3.1 label-studio-sdk==2.1.2 supervision==0.31.2``. Run ``python write.py datumaro``, then
``python write.py others``. Roboflow exports masks on its servers alone: the test writes them by its documentation.
"""

import json
import pathlib
import shutil
import sys
import tempfile
from typing import Any
from urllib.parse import unquote

import cv2
import numpy as np
from PIL import Image

HERE = pathlib.Path(__file__).parent
HAND = [[3.24, 4.17, 20.68, 3.36, 22.44, 17.82, 9.15, 20.23], [28.04, 5.12, 36.46, 6.57, 33.02, 14.08]]
CUP = [24.34, 20.14, 38.86, 21.03, 37.25, 28.77, 25.06, 27.02]
SIZES = {"one hand": (30, 40), "Hände 2": (24, 32), "cup only": (24, 32), "nothing": (24, 32)}


def masks() -> tuple[np.ndarray, np.ndarray]:
    """Return a hand in two parts, one with a hole, and a cup that covers a corner of it."""
    hand, cup = np.zeros((24, 32), bool), np.zeros((24, 32), bool)
    hand[4:20, 5:20], hand[9:14, 9:15], hand[2:6, 24:30], cup[15:22, 18:29] = True, False, True, True
    return hand, cup


def _save(name: str, mask: np.ndarray, stem: str) -> None:
    """Store the mask that a tool reads back."""
    folder = HERE / "expected" / name
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(mask.astype(bool)).save(folder / f"{stem}.png")


def write_images() -> None:
    """Write the images, which all formats share."""
    shutil.rmtree(HERE / "images", ignore_errors=True)
    (HERE / "images").mkdir()
    for seed, (stem, (height, width)) in enumerate(SIZES.items()):
        coarse = np.random.default_rng(seed).integers(0, 256, (3, 4, 3), dtype=np.uint8)
        smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        Image.fromarray(smooth).save(HERE / "images" / f"{stem}.jpg", quality=60)


def write_datumaro() -> None:
    """COCO with polygons and uncompressed run lengths, CVAT for images, CVAT's segmentation mask."""
    import datumaro as dm
    from datumaro.components.media import Image as Media

    hand, cup = masks()
    regions = {
        "one hand": [
            *(dm.Polygon(points, label=0, group=i) for i, points in enumerate(HAND)),
            dm.Polygon(CUP, label=1),
        ],
        "Hände 2": [dm.Mask(hand, label=0, group=4), dm.Mask(cup, label=1, group=5, z_order=1)],
        "cup only": [dm.Mask(cup, label=1)],
        "nothing": [],
    }
    label_map = {"background": [[0, 0, 0], [], []], "hand": [[250, 50, 83], [], []], "cup": [[50, 183, 250], [], []]}
    for name, form, options in (
        ("coco", "coco_instances", {"segmentation_mode": "guess"}),
        ("coco-runs", "coco_instances", {"segmentation_mode": "mask"}),
        ("cvat", "cvat", {}),
        ("cvat-masks", "voc_segmentation", {"label_map": label_map, "apply_colormap": True}),
    ):
        items = [
            dm.DatasetItem(
                stem,
                subset="train",
                media=Media.from_file(str(HERE / "images" / f"{stem}.jpg")),
                annotations=annotations,
            )
            for stem, annotations in regions.items()
        ]
        dataset = dm.Dataset.from_iterable(items, categories=["hand", "cup"])
        if name == "cvat-masks":
            dataset.transform("polygons_to_masks").transform("merge_instance_segments")
        folder = _folder(name)
        dataset.export(str(folder), form, save_media=True, **options)
        read = dm.Dataset.import_from(str(folder), form).transform("polygons_to_masks")
        number = next(
            i for i, category in enumerate(read.categories()[dm.AnnotationType.label]) if category.name == "hand"
        )
        for item in read:
            mask = np.zeros(SIZES[item.id], bool)
            regions_read = [one for one in item.annotations if one.type == dm.AnnotationType.mask]
            for annotation in sorted(regions_read, key=lambda one: one.z_order):
                if annotation.label == number:
                    mask |= annotation.image.astype(bool)
                elif name == "cvat":  # a higher shape hides a lower one
                    mask &= ~annotation.image.astype(bool)
            if item.id in ("one hand", "Hände 2"):
                _save(name, mask, item.id)
        for copied in ("images", "JPEGImages", "SegmentationObject"):  # datumaro reads no labels without their images
            shutil.rmtree(folder / copied, ignore_errors=True)


def write_others() -> None:
    """COCO with compressed run lengths, labelme, Label Studio, VOC, Roboflow."""
    for write in (_write_compressed, _write_labelme, _write_label_studio, _write_voc, _write_roboflow):
        write()


def _folder(name: str) -> pathlib.Path:
    shutil.rmtree(HERE / name, ignore_errors=True)
    (HERE / name).mkdir()
    return HERE / name


def _write_compressed() -> None:
    """Compress the run lengths of ``coco-runs`` with pycocotools."""
    from pycocotools import mask as coco_mask
    from pycocotools.coco import COCO

    document = json.loads((HERE / "coco-runs" / "annotations" / "instances_train.json").read_text())
    for annotation in document["annotations"]:
        packed = coco_mask.frPyObjects(annotation["segmentation"], *annotation["segmentation"]["size"])
        annotation["segmentation"] = {"size": packed["size"], "counts": packed["counts"].decode()}
    path = _folder("coco-compressed") / "labels.json"
    path.write_text(json.dumps(document))
    _save_coco("coco-compressed", COCO(str(path)))


def _save_coco(name: str, coco: Any) -> None:
    names = {category["name"]: number for number, category in coco.cats.items()}
    for number, image in coco.imgs.items():
        stem, found = pathlib.PurePath(unquote(image["file_name"])).stem, coco.getAnnIds(number, names["hand"])
        if found:
            _save(name, np.any([coco.annToMask(one) for one in coco.loadAnns(found)], axis=0), stem)


def _write_labelme() -> None:
    """Save label files, and read them with labelme's own conversion to label images."""
    from labelme._label_file import LabelFile, read_label_file
    from labelme.utils import img_arr_to_b64
    from labelme.utils.shape import shapes_to_label

    def region(label: str, mask: np.ndarray) -> dict[str, Any]:
        top_left, bottom_right = np.argwhere(mask).min(0), np.argwhere(mask).max(0)
        part = mask[top_left[0] : bottom_right[0] + 1, top_left[1] : bottom_right[1] + 1]
        points = [top_left[::-1].tolist(), bottom_right[::-1].tolist()]
        return _shape(label, points, "mask") | {"mask": img_arr_to_b64(part.astype(np.uint8))}

    def _shape(label: str, points: list[Any], kind: str) -> dict[str, Any]:
        return {"label": label, "points": np.reshape(points, (-1, 2)).tolist(), "shape_type": kind, "flags": {}}

    hand, cup = masks()
    shapes = {
        "one hand": [*(_shape("hand", points, "polygon") for points in HAND), _shape("cup", CUP, "polygon")],
        "Hände 2": [region("hand", hand), region("cup", cup)],
        "cup only": [_shape("cup", [12, 12, 15, 16], "circle"), _shape("cup", [2, 3, 9, 8], "rectangle")],
        "nothing": [],
    }
    folder = _folder("labelme")
    for stem, size in SIZES.items():
        file = str(folder / f"{stem}.json")
        LabelFile().save(
            file, shapes[stem], f"..\\images\\{stem}.jpg" if stem == "one hand" else f"../images/{stem}.jpg", *size
        )
        if "hand" in str(shapes[stem]):
            shutil.copy(HERE / "images" / f"{stem}.jpg", folder)
            LabelFile().save(str(folder / "read.json"), shapes[stem], f"{stem}.jpg", *size)
            classes, _ = shapes_to_label(size, read_label_file(str(folder / "read.json")).shapes, {"hand": 1, "cup": 2})
            _save("labelme", classes == 1, stem)
    for path in [*folder.glob("*.jpg"), folder / "read.json"]:
        path.unlink()


def _write_label_studio() -> None:
    """Convert the COCO polygons with Label Studio's converter, add brush strokes, and convert back to COCO."""
    from label_studio_sdk.converter import Converter, brush
    from label_studio_sdk.converter.imports.coco import convert_coco_to_ls
    from pycocotools.coco import COCO

    folder, work = _folder("label-studio"), pathlib.Path(tempfile.mkdtemp())
    coco = json.loads((HERE / "coco" / "annotations" / "instances_train.json").read_text())
    coco["annotations"] = [
        {k: v for k, v in one.items() if k != "bbox"} for one in coco["annotations"] if not one["iscrowd"]
    ]
    (work / "coco.json").write_text(json.dumps(coco))
    convert_coco_to_ls(
        str(work / "coco.json"), str(work / "tasks.json"), from_name="tag", image_root_url="/data/local-files/?d=images"
    )
    tasks = json.loads((work / "tasks.json").read_text())
    hand, cup = masks()
    for number, task in enumerate(tasks, start=1):
        task["id"] = number
        for label, mask in {2: {"hand": hand, "cup": cup}, 3: {"cup": cup}}.get(number, {}).items():
            Image.fromarray(mask).save(work / "mask.png")
            stroke = brush.image2annotation(str(work / "mask.png"), label, "brush", "image")["result"]
            task["annotations"][0]["result"] += stroke
            if label == "hand":
                alpha = brush.decode_rle(stroke[0]["value"]["rle"]).reshape(*mask.shape, 4)[..., 3]
                _save("label-studio", alpha > 0, "Hände 2")
    (folder / "tasks.json").write_text(json.dumps(tasks))
    labels = '<Label value="hand"/><Label value="cup"/>'
    config = f"""<View><Image name="image" value="$image"/>
        <PolygonLabels name="tagpolygons" toName="image">{labels}</PolygonLabels>
        <BrushLabels name="brush" toName="image">{labels}</BrushLabels></View>"""
    Converter(config, str(work), download_resources=False).convert_to_coco(
        str(folder / "tasks.json"), str(work / "out"), is_dir=False
    )
    _save_coco("label-studio", COCO(str(work / "out" / "result.json")))


def _write_voc() -> None:
    """Write palette images with imgviz, as labelme's conversion to VOC does."""
    import imgviz.io

    hand, cup = masks()
    folder = _folder("voc") / "SegmentationClass"
    folder.mkdir()
    classes = np.where(cup, 5, np.where(hand, 15, 0)).astype(np.uint8)
    classes[hand & ~cv2.erode(hand.astype(np.uint8), np.ones((2, 2))).astype(bool)] = 255
    imgviz.io.lblsave(folder / "Hände 2.png", classes)
    _save("voc", classes == 15, "Hände 2")


def _write_roboflow() -> None:
    """Write COCO with supervision, which is Roboflow's, from the masks."""
    import supervision as sv

    hand, cup = masks()
    folder, path = _folder("roboflow") / "train", str(HERE / "images" / "Hände 2.jpg")
    both = np.stack([hand, cup])
    detections = sv.Detections(xyxy=sv.mask_to_xyxy(both), mask=both, class_id=np.array([1, 2]))
    dataset = sv.DetectionDataset(["objects", "hand", "cup"], [path], {path: detections})
    dataset.as_coco(annotations_path=str(folder / "_annotations.coco.json"))
    read = sv.DetectionDataset.from_coco(str(HERE / "images"), str(folder / "_annotations.coco.json"), force_masks=True)
    _, _, found = read[0]
    _save("roboflow", found.mask[found.class_id == 1].any(axis=0), "Hände 2")


if __name__ == "__main__":
    if sys.argv[1] == "datumaro":
        write_images()
        write_datumaro()
    else:
        write_others()
