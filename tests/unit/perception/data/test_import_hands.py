"""Label files that the tools wrote themselves (tests/golden/labels) give the pixels that the tools read from them."""

import json
import shutil
import sys
import tracemalloc

import cv2
import numpy as np
import pytest
from PIL import Image

from deltasafe import cli
from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.data.importing.import_hands import import_hands
from deltasafe.perception.data.importing.settings import ImportSettings
from deltasafe.perception.data.labeled_images import LabeledImageSet
from evidence.labels import GOLDEN, SOURCES, lay_out, read_masks

HAND = ImportSettings(classes=("hand",))
VOC_PERSON = ImportSettings(classes=("person",))


@pytest.fixture
def source(tmp_path):
    """Return a function that lays out the labels and images of a format."""

    return lambda name: lay_out(name, tmp_path)


def masks_of(folder):
    return read_masks(folder / "masks")


@pytest.mark.parametrize("name", SOURCES)
def test_labels_of_each_tool_give_its_own_pixels(source, tmp_path, name):
    report = import_hands(source(name), tmp_path / "out", VOC_PERSON if name == "voc" else HAND)
    assert report.format == ("coco" if name == "roboflow" else SOURCES[name][0])
    expected = read_masks(GOLDEN / "expected" / name)
    found = masks_of(tmp_path / "out")
    for stem, mask in expected.items():
        np.testing.assert_array_equal(found.pop(stem), mask, err_msg=stem)
    assert not any(mask.any() for mask in found.values()), "images without a hand"
    hands = LabeledImageSet.load(tmp_path / "out")
    assert {item.id for item in hands.items} == expected.keys() | found.keys()
    for item in hands.items:
        assert item.image.read_bytes() == (GOLDEN / "images" / item.image.name).read_bytes()


def test_images_without_annotation_are_skipped_or_kept(source, tmp_path):
    coco = source("coco")
    report = import_hands(coco, tmp_path / "out", HAND)
    assert [(image.source, image.id) for image in report.images if image.source != "one hand.jpg"] == [
        ("Hände 2.jpg", "Hände 2"),
        ("cup only.jpg", "cup only"),
        ("nothing.jpg", ""),
    ]
    assert "--keep-unlabeled" in report.skipped[0].reason
    kept = import_hands(coco, tmp_path / "kept", ImportSettings(classes=("hand",), keep_unlabeled=True))
    assert not kept.skipped
    assert not masks_of(tmp_path / "kept")["nothing"].any()


def test_several_classes_merge(source, tmp_path):
    import_hands(source("coco"), tmp_path / "out", ImportSettings(classes=("hand", "cup")))
    import_hands(source("cvat-masks"), tmp_path / "all", ImportSettings(classes=("*",)))
    both, stars = masks_of(tmp_path / "out"), masks_of(tmp_path / "all")
    for stem in ("one hand", "Hände 2", "cup only"):
        np.testing.assert_array_equal(both[stem], stars[stem])


def test_ambiguous_and_unknown_classes_list_those_found(source, tmp_path):
    folder = source("labelme")
    with pytest.raises(DataError, match=r"several classes: cup \(3 images\), hand \(2 images\); give --class"):
        import_hands(folder, tmp_path / "out")
    with pytest.raises(DataError, match=r"no class Hand; choose from those found: cup \(3 images\), hand"):
        import_hands(folder, tmp_path / "out", ImportSettings(classes=("Hand",)))
    assert not (tmp_path / "out").exists()


def test_missing_images_are_listed(source, tmp_path):
    folder = source("label-studio")
    (folder / "deeper" / "images" / "one hand.jpg").unlink()
    report = import_hands(folder, tmp_path / "out", HAND)
    assert [image.source for image in report.skipped] == ["one hand.jpg"]
    assert "--images" in report.skipped[0].reason
    shutil.copytree(GOLDEN / "images", tmp_path / "elsewhere")
    settings = ImportSettings(classes=("hand",), images=str(tmp_path / "elsewhere"))
    assert not import_hands(folder / "tasks.json", tmp_path / "found", settings).skipped


def test_rectangles_are_no_outlines_unless_told(source, tmp_path):
    folder, cup = source("labelme"), {"classes": ("cup",)}
    report = import_hands(folder, tmp_path / "out", ImportSettings(**cup))
    assert [(image.source, image.reason) for image in report.skipped] == [
        (
            "../images/cup only.jpg",
            "has a label that cannot be used: a rectangle of cup; give --rectangles fill, or ignore",
        )
    ]
    import_hands(folder, tmp_path / "fill", ImportSettings(**cup, rectangles="fill"))
    import_hands(folder, tmp_path / "ignore", ImportSettings(**cup, rectangles="ignore"))
    filled, ignored = masks_of(tmp_path / "fill")["cup only"], masks_of(tmp_path / "ignore")["cup only"]
    assert filled[3:9, 2:10].all()
    assert not ignored[3:9, 2:5].any()
    assert ignored[12, 12]


def test_coco_boxes_are_rectangles(source, tmp_path):
    folder = source("coco")
    path = folder / "annotations" / "instances_train.json"
    document = json.loads(path.read_text())
    for annotation in document["annotations"]:
        annotation["segmentation"] = []
    path.write_text(json.dumps(document))
    with pytest.raises(DataError, match=r"2 x has a label that cannot be used.*--rectangles"):
        import_hands(folder, tmp_path / "out", HAND)
    import_hands(folder, tmp_path / "out", ImportSettings(classes=("hand",), rectangles="fill"))
    assert masks_of(tmp_path / "out")["Hände 2"][2:20, 5:30].all()


def test_border_of_voc_objects_is_a_class_of_its_own(source, tmp_path):
    folder = source("voc")
    report = import_hands(folder, tmp_path / "out", VOC_PERSON)
    labeled = next(image for image in report.images if image.id == "Hände 2")
    index = np.asarray(Image.open(GOLDEN / "voc" / "SegmentationClass" / "Hände 2.png"))
    assert labeled.reason == f"{(index == 255).sum()} void pixels"
    import_hands(folder, tmp_path / "void", ImportSettings(classes=("person", "void")))
    np.testing.assert_array_equal(masks_of(tmp_path / "void")["Hände 2"], np.isin(index, (15, 255)))


def test_roboflow_masks(tmp_path):
    """Roboflow exports on its servers alone; the layout is that of its documentation."""
    folder = tmp_path / "export" / "train"
    folder.mkdir(parents=True)
    (folder / "_classes.csv").write_text("Pixel Value, Class\n0, background\n1, cup\n2, hand\n")
    values = np.zeros((30, 40), np.uint8)
    values[5:12, 6:20], values[15:20, 3:9] = 2, 1
    shutil.copy(GOLDEN / "images" / "one hand.jpg", folder / "one_jpg.rf.0a1b.jpg")
    Image.fromarray(values).save(folder / "one_jpg.rf.0a1b_mask.png")
    report = import_hands(tmp_path / "export", tmp_path / "out", HAND)
    assert (report.format, report.classes) == ("roboflow", ("hand",))
    np.testing.assert_array_equal(masks_of(tmp_path / "out")["one_jpg.rf.0a1b"], values == 2)


def plain(folder, masks, images="images", suffix=""):
    """Write a plain folder from masks by stem."""
    for stem, mask in masks.items():
        for name in (images, "labels" if not suffix else images):
            (folder / name).mkdir(parents=True, exist_ok=True)
        height, width = mask.shape[:2]
        Image.fromarray(np.full((height, width, 3), 90, np.uint8)).save(folder / images / f"{stem}.jpg")
        Image.fromarray(mask).save(folder / ("labels" if not suffix else images) / f"{stem}{suffix}.png")
    return folder


@pytest.fixture
def hand():
    mask = np.zeros((20, 30), bool)
    mask[5:20, 6:14] = True
    return mask


def test_plain_folders_and_masks_beside_images(tmp_path, hand):
    plain(tmp_path / "folders", {"a": hand, "b": ~~hand[:, ::-1]})
    plain(tmp_path / "beside", {"a": hand, "b": hand[:, ::-1]}, images="all", suffix="_mask")
    for name in ("folders", "beside"):
        report = import_hands(tmp_path / name, tmp_path / f"{name}-out")
        assert report.classes == ("255",)
        np.testing.assert_array_equal(masks_of(tmp_path / f"{name}-out")["b"], hand[:, ::-1])


def test_classes_over_several_files_are_not_merged_silently(tmp_path, hand):
    """Each mask has one value, but they are two classes."""
    folder = plain(tmp_path / "set", {"a": hand.astype(np.uint8), "b": hand.astype(np.uint8) * 2})
    with pytest.raises(DataError, match=r"several classes: 1 \(1 images\), 2 \(1 images\)"):
        import_hands(folder, tmp_path / "out")
    import_hands(folder, tmp_path / "out", ImportSettings(classes=("2",)))
    found = masks_of(tmp_path / "out")
    assert not found["a"].any()
    np.testing.assert_array_equal(found["b"], hand)
    (folder / "labels").rename(folder / "masks")
    with pytest.raises(DataError, match=r"perhaps of several classes: 1 .*, 2 .*--class '1' --class '2'"):
        LabeledImageSet.load(folder)


def test_inverted_masks_are_refused_with_an_option_that_works(tmp_path, hand):
    folder = plain(tmp_path / "set", {"a": ~hand, "b": ~hand})
    with pytest.raises(DataError, match=r"--inverted .*--large-masks(.|\n)*a.jpg marks 80%(.|\n)*b.jpg marks 80%"):
        import_hands(folder, tmp_path / "out")
    import_hands(folder, tmp_path / "inverted", ImportSettings(inverted=True))
    np.testing.assert_array_equal(masks_of(tmp_path / "inverted")["a"], hand)
    import_hands(folder, tmp_path / "large", ImportSettings(large_masks=True))
    assert LabeledImageSet.load(tmp_path / "large").read(0)[1].mean() == 0.8
    import_hands(tmp_path / "large", tmp_path / "again")  # it is confirmed in dataset.json


def test_the_loader_refuses_inverted_masks_until_confirmed(tmp_path, hand):
    folder = plain(tmp_path / "set", {"a": ~hand, "b": hand})
    (folder / "labels").rename(folder / "masks")
    with pytest.raises(DataError, match=r"a\.png: marks 80% .* \{\"large_masks\": true\}") as raised:
        LabeledImageSet.load(folder)
    assert str(folder / "dataset.json") in str(raised.value)
    (folder / "dataset.json").write_text('{"large_masks": true}')
    assert len(LabeledImageSet.load(folder)) == 2


def test_soft_masks_and_thresholds(tmp_path, hand):
    soft = cv2.GaussianBlur(hand.astype(np.uint8) * 255, (0, 0), 1.0)
    folder = plain(tmp_path / "set", {"a": soft})
    with pytest.raises(DataError, match=r"several classes: .*--threshold 0\.5"):
        import_hands(folder, tmp_path / "out")
    report = import_hands(folder, tmp_path / "out", ImportSettings(threshold=0.5))
    assert report.classes == (">= 0.5",)
    np.testing.assert_array_equal(masks_of(tmp_path / "out")["a"], soft >= 128)
    with pytest.raises(SettingsError, match="either threshold or classes"):
        ImportSettings(threshold=0.5, classes=("hand",))


def test_options_for_mask_files_are_refused_for_outlines(source, tmp_path):
    with pytest.raises(DataError, match="no mask files; remove --threshold"):
        import_hands(source("coco"), tmp_path / "out", ImportSettings(threshold=0.5))


def test_photographs_turned_by_exif(tmp_path):
    """Tools draw on the upright picture."""
    exif = Image.Exif()
    exif[0x0112] = 3
    pixels = np.zeros((20, 30, 3), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.png", exif=exif)
    shape = {"label": "hand", "points": [[2, 2], [9, 2], [9, 9], [2, 9]], "shape_type": "polygon"}
    document = {"shapes": [shape], "imagePath": "a.png", "imageHeight": 20, "imageWidth": 30}
    (tmp_path / "a.json").write_text(json.dumps(document))
    for drawn_on, corner in (("", (2, 2)), ("upright", (2, 2)), ("stored", (17, 27))):
        import_hands(tmp_path, tmp_path / f"out{drawn_on}", ImportSettings(masks_drawn_on=drawn_on))
        _, mask = LabeledImageSet.load(tmp_path / f"out{drawn_on}").read(0)
        assert mask[corner]
        assert not mask[19 - corner[0], 29 - corner[1]]


def test_equal_names_in_two_folders_are_kept_apart(tmp_path, hand):
    plain(tmp_path / "set" / "kitchen", {"a": hand})
    plain(tmp_path / "set" / "office", {"a": hand, "b": hand})
    import_hands(tmp_path / "set", tmp_path / "out")
    assert len(LabeledImageSet.load(tmp_path / "out")) == 3


def test_used_folders_archives_and_ambiguous_formats_are_refused(source, tmp_path):
    folder = source("coco")
    with pytest.raises(DataError, match="exists already"):
        import_hands(folder, folder, HAND)
    (tmp_path / "export.zip").write_bytes(b"PK")
    with pytest.raises(DataError, match="unpack it"):
        import_hands(tmp_path / "export.zip", tmp_path / "out", HAND)
    shutil.copy(GOLDEN / "cvat" / "train.xml", folder)
    with pytest.raises(DataError, match="several formats; give --format coco or --format cvat"):
        import_hands(folder, tmp_path / "out", HAND)
    assert import_hands(folder, tmp_path / "out", ImportSettings("cvat", ("hand",))).format == "cvat"


def test_command_writes_sheet_and_tables(source, tmp_path, capsys):
    folder, out = source("cvat"), tmp_path / "out"
    assert cli.main(["hands", "import", str(folder), str(out), "--class", "hand"]) == 0
    printed = capsys.readouterr().out
    assert "skipped nothing.jpg: has no annotation" in printed
    assert "3 images of the format cvat, obstacle: hand (recorded as hand); 1 skipped" in printed
    assert "| nothing.jpg | skipped |" in (out / "import.md").read_text()
    assert json.loads((out / "import.json").read_text())["classes"] == ["hand"]
    with Image.open(out / "contact_sheet.jpg") as sheet:
        tinted = np.asarray(sheet).astype(int)
    assert sheet.width == 3 * 246 + 6
    assert (tinted[..., 2] - tinted[..., 0] > 30).any()
    assert cli.main(["hands", "import", str(folder), str(out)]) == 1
    assert "exists already" in capsys.readouterr().err


def test_photographs_are_converted_one_after_another(tmp_path):
    """Memory is that of one photograph, however many there are and however large they are."""
    height, width, peaks = 600, 800, []
    for n in (2, 8):
        folder = tmp_path / f"{n}"
        for part in ("images", "masks"):
            (folder / part).mkdir(parents=True)
        for k in range(n):
            mask = np.zeros((height, width), np.uint8)
            mask[100 + k : 200, 100:300] = 255
            cv2.imwrite(str(folder / "images" / f"{k}.jpg"), np.full((height, width, 3), 20 * k, np.uint8))
            cv2.imwrite(str(folder / "masks" / f"{k}.png"), mask)
        tracemalloc.start()
        import_hands(folder, tmp_path / f"out {n}")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]
    assert peaks[0] < 30 * height * width, "bytes per pixel"


def test_label_studio_labels_in_a_control_of_their_own(source, tmp_path):
    """A region and its labels are two results; a region may have two labels, or none."""
    folder = source("label-studio")
    tasks = json.loads((folder / "tasks.json").read_text())
    first, cup, second = tasks[0]["annotations"][0]["result"]
    for region in (first, second):
        region["type"], _ = "polygon", region["value"].pop("polygonlabels")
    named = {"id": first["id"], "type": "labels", "value": {"labels": ["hand", "left"]}, "to_name": "image"}
    tasks[0]["annotations"][0]["result"] = [first, cup, named, second]
    (folder / "tasks.json").write_text(json.dumps(tasks))
    with pytest.raises(DataError, match=r"hand \(2 images\), left \(1 images\), unlabeled \(1 images\)"):
        import_hands(folder, tmp_path / "out")
    import_hands(folder, tmp_path / "out", ImportSettings(classes=("left", "unlabeled")))
    expected = np.asarray(Image.open(GOLDEN / "expected" / "label-studio" / "one hand.png"))
    np.testing.assert_array_equal(masks_of(tmp_path / "out")["one hand"], expected)


def test_command_without_the_extra_names_it(source, tmp_path, capsys, monkeypatch):
    folder = source("coco")
    for name in [name for name in sys.modules if "importing.import_hands" in name]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "deltasafe.perception.data.importing.formats", None)
    assert cli.main(["hands", "import", str(folder), str(tmp_path / "out")]) == 1
    assert "deltasafe[vision]" in capsys.readouterr().err


def test_set_is_named_after_its_classes(source, tmp_path):
    folder = source("coco")
    named = {"cup": ("cup",), "hand": ("hand",), "hand_or_cup": ("hand", "cup")}
    for obstacle, classes in named.items():
        report = import_hands(folder, tmp_path / obstacle, ImportSettings(classes=classes))
        assert report.obstacle == LabeledImageSet.load(tmp_path / obstacle).info.obstacle == obstacle
    import_hands(source("voc"), tmp_path / "voc-out", ImportSettings(classes=("person",), obstacle="hand"))
    assert LabeledImageSet.load(tmp_path / "voc-out").info.obstacle == "hand"
    again = import_hands(tmp_path / "cup", tmp_path / "again")
    assert (again.format, again.obstacle) == ("folder", "cup")
    with pytest.raises(SettingsError, match="obstacle must be an identifier"):
        import_hands(folder, tmp_path / "out", ImportSettings(classes=("cup",), obstacle="Cup!"))
