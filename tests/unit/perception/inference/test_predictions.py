import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.inference.predictions import MemberPredictions

STACKS = {
    "wide": np.linspace(0, 1, 2 * 3 * 7, dtype=np.float32).reshape(2, 3, 7),
    "tall": np.linspace(0, 1, 2 * 5 * 4, dtype=np.float32).reshape(2, 5, 4),
}


def test_written_predictions_are_read_back_and_each_image_is_predicted_once(tmp_path):
    predicted, reports = [], []

    def predict(image_id):
        predicted.append(image_id)
        return STACKS[image_id]

    written = MemberPredictions.write(
        tmp_path / "p", list(STACKS), predict, lambda done, total, _: reports.append((done, total))
    )
    opened = MemberPredictions(tmp_path / "p")
    assert predicted == ["wide", "tall"]
    assert reports == [(1, 2), (2, 2)]
    assert (opened.image_ids, opened.n_members, len(opened)) == (("wide", "tall"), 2, 2)
    for stack, again, expected in zip(written, opened, STACKS.values(), strict=True):
        np.testing.assert_array_equal(stack, expected)
        np.testing.assert_array_equal(again, expected)
    assert [stack.shape for stack in opened[1:]] == [(2, 5, 4)]
    np.testing.assert_array_equal(opened[-1], STACKS["tall"])
    with pytest.raises(IndexError):
        opened[2]


def test_failed_run_leaves_no_files(tmp_path):
    def predict(image_id):
        if image_id == "tall":
            raise RuntimeError("out of memory")
        return STACKS[image_id]

    with pytest.raises(RuntimeError):
        MemberPredictions.write(tmp_path / "p", list(STACKS), predict)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("stack", "match"),
    [
        (np.zeros((3, 4)), r"\(M, H, W\)"),
        (np.zeros((0, 3, 4)), r"\(M, H, W\)"),
        (np.full((1, 3, 4), 2.0), r"\[0, 1\]"),
        (np.full((1, 3, 4), np.nan), r"\[0, 1\]"),
    ],
)
def test_invalid_predictions_are_refused(tmp_path, stack, match):
    with pytest.raises(SettingsError, match=match):
        MemberPredictions.write(tmp_path / "p", ["a"], lambda _: stack)
    assert not (tmp_path / "p").exists()


def test_repeated_ids_and_changing_number_of_members_are_refused(tmp_path):
    for image_ids in ([], ["a", "a"]):
        with pytest.raises(SettingsError, match="unique"):
            MemberPredictions.write(tmp_path / "p", image_ids, lambda _: np.zeros((1, 2, 2)))
    sizes = {"a": 2, "b": 3}
    with pytest.raises(SettingsError, match="predictions of b"):
        MemberPredictions.write(tmp_path / "p", ["a", "b"], lambda name: np.zeros((sizes[name], 2, 2)))


def test_damaged_files_are_named(tmp_path):
    folder = tmp_path / "p"
    with pytest.raises(DataError, match="missing"):
        MemberPredictions(folder)
    stored = MemberPredictions.write(folder, list(STACKS), STACKS.__getitem__)
    (folder / "0000.npy").write_bytes(b"not an array")
    with pytest.raises(DataError, match=r"0000\.npy: cannot be read"):
        stored[0]
    np.save(folder / "0001.npy", np.zeros((5, 5, 4), np.float32))
    with pytest.raises(DataError, match=r"must be \(2, H, W\)"):
        stored[1]
    (folder / "index.json").write_text("{}")
    with pytest.raises(DataError, match="image_ids"):
        MemberPredictions(folder)
