"""Cameras located by a board: poses of rendered images, uncertainty, ambiguous and wrong boards, the printed page."""

import dataclasses
import json
import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from deltasafe.cameras import CameraModel, locate, read_camera
from deltasafe.cameras.board import Board, draw_board
from deltasafe.cameras.locate import MAX_TABLE_STD_M, _table_std_m, locate_camera
from deltasafe.cli import main
from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose
from evidence.board_images import Lens, look_at, render_board
from evidence.cameras import LENSES, model_of

CHARUCO, APRILTAG = "charuco:7x5:0.030:0.022", "apriltag:4x3:0.040:0.010"
BARREL = Lens((640, 480), np.array([[450.0, 0, 323.6], [0, 448, 237.1], [0, 0, 1]]), np.array([-0.3, 0.1, 1e-3, 0, 0]))
MIDDLE = {CHARUCO: (0.105, 0.075, 0.0), APRILTAG: (0.095, 0.07, 0.0)}


def rendered(text, view, seed=0, lens=BARREL, origin=(0.0, 0.0, 0.0, 0.0)):
    return render_board(Board.parse(text), lens, view, origin, np.random.default_rng(seed))


def view_of(text, distance_m=0.4, tilt_rad=0.5, azimuth_rad=0.4, roll_rad=1.1):
    return look_at(np.array(MIDDLE[text]), distance_m, tilt_rad, azimuth_rad, roll_rad)


@given(
    st.sampled_from([CHARUCO, APRILTAG]),
    st.floats(0.3, 0.45),
    st.floats(0.0, 0.8),
    st.floats(-3.1, 3.1),
    st.floats(-3.1, 3.1),
    st.integers(0, 99),
)
@settings(deadline=None, max_examples=6)
def test_poses_are_found_within_a_millimeter_on_the_table(text, distance_m, tilt_rad, azimuth_rad, roll_rad, seed):
    view = view_of(text, distance_m, tilt_rad, azimuth_rad, roll_rad)
    found = locate_camera(rendered(text, view, seed), model_of(BARREL, "plumb_bob"), Board.parse(text))
    camera = found.model.pinhole()
    turned = Rotation.from_matrix(view.rotation.T @ camera.world_from_camera_rotation).magnitude()
    assert found.error_px < 0.4
    assert np.linalg.norm(camera.position_m - view.position_m) < 0.005
    assert math.degrees(turned) < 0.7
    true = found.model.placed(view.position_m, view.rotation).pinhole()
    uv, _ = true.project(np.array([(0.0, 0, 0), (0.2, 0, 0), (0.2, 0.15, 0), (0, 0.15, 0)]))
    apart_m = np.linalg.norm(camera.pixel_to_plane(uv, 0.0) - true.pixel_to_plane(uv, 0.0), axis=1)
    assert apart_m.max() < 0.001


CASES = [(CHARUCO, name) for name in LENSES] + [(APRILTAG, name) for name in ("pinhole", "equidistant")]


@pytest.mark.parametrize(("text", "lens_name"), CASES)
def test_no_half_pixel_is_lost_for_any_lens_and_board(text, lens_name):
    lens, name = LENSES[lens_name]
    view = view_of(text, 0.35)
    found = locate_camera(rendered(text, view, lens=lens), model_of(lens, name), Board.parse(text)).model
    corners = np.array([(0.0, 0, 0), (0.18, 0, 0), (0.18, 0.13, 0), (0, 0.13, 0)])
    apart_px = found.project(corners) - found.placed(view.position_m, view.rotation).project(corners)
    assert np.abs(apart_px.mean(axis=0)).max() < 0.15


def test_the_origin_of_the_board_moves_the_camera():
    view, origin = view_of(CHARUCO), Pose(0.3, -0.1, 0.02, 2.0)
    image, model, board = rendered(CHARUCO, view), model_of(BARREL, "plumb_bob"), Board.parse(CHARUCO)
    at_zero, moved = locate_camera(image, model, board), locate_camera(image, model, board, origin)
    turn, shift = Rotation.from_euler("z", 2.0).as_matrix(), np.array([0.3, -0.1, 0.02])
    np.testing.assert_allclose(moved.model.position_m, turn @ at_zero.model.position_m + shift, atol=1e-9)
    np.testing.assert_allclose(moved.corners_m, at_zero.corners_m @ turn.T + shift, atol=1e-12)
    uv = moved.model.project(moved.corners_m)
    np.testing.assert_allclose(uv, at_zero.model.project(at_zero.corners_m), atol=1e-6)
    assert math.sqrt(((uv - moved.corners_uv) ** 2).sum(axis=1).mean()) == pytest.approx(moved.error_px)


@pytest.mark.parametrize("is_legacy", [False, True])
def test_boards_with_a_white_corner_are_located_as_well(is_legacy, monkeypatch):
    board = Board.parse("charuco:7x6:0.025:0.018")
    view = look_at(np.array([0.09, 0.075, 0]), 0.35, 0.4, 0.2, 0.3)
    if is_legacy:
        monkeypatch.setitem(board.__dict__, "opencv", board.legacy)
    image = render_board(board, BARREL, view, (0.0, 0.0, 0.0, 0.0), np.random.default_rng(0))
    found = locate_camera(image, model_of(BARREL, "plumb_bob"), Board.parse("charuco:7x6:0.025:0.018"))
    assert np.linalg.norm(found.model.position_m - view.position_m) < 0.003
    assert len(found.corners_uv) == 30


def test_a_resized_image_gives_the_same_pose():
    view = view_of(CHARUCO, 0.35)
    image = rendered(CHARUCO, view, lens=LENSES["plumb_bob"][0])
    model = model_of(*LENSES["plumb_bob"])
    small = cv2.resize(image, (960, 540), interpolation=cv2.INTER_AREA)
    whole, part = (locate_camera(one, model, Board.parse(CHARUCO)).model.pinhole() for one in (image, small))
    assert np.linalg.norm(whole.position_m - part.position_m) < 0.001


def test_the_uncertainty_on_the_table_equals_its_numerical_derivative():
    rng = np.random.default_rng(0)
    turn, position_m = Rotation.from_euler("xyz", (2.9, 0.2, 0.3)), np.array([0.1, -0.05, 0.6])
    corners_m, root = rng.uniform(0, 0.2, (10, 3)) * (1, 1, 0), rng.normal(size=(6, 6)) * 1e-4
    angles = np.arange(8) * math.pi / 4
    ring = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]) * 0.3 + corners_m.mean(axis=0)
    local = turn.inv().apply(ring - position_m)

    def hits(change):
        rays, start = (turn * Rotation.from_rotvec(change[:3])).apply(local), position_m + change[3:]
        return (start - rays * (start[2] / rays[:, 2])[:, None])[:, :2]

    slopes = np.stack([(hits(step) - hits(-step)) / 2e-6 for step in 1e-6 * np.eye(6)], axis=-1)
    expected = max(np.trace(one @ root @ root.T @ one.T) for one in slopes)
    assert _table_std_m(turn, position_m, corners_m, root @ root.T) == pytest.approx(math.sqrt(expected), rel=1e-6)


def test_images_that_do_not_determine_the_pose_are_refused():
    model, board = model_of(BARREL, "plumb_bob"), Board.parse(CHARUCO)
    with pytest.raises(SettingsError, match="shows 0 corners of the board, 8 are needed, and 0 markers"):
        locate_camera(np.full((480, 640, 3), 128, np.uint8), model, board)
    image = rendered(CHARUCO, view_of(CHARUCO))
    with pytest.raises(SettingsError, match=r"shows \d corners"):
        locate_camera(image, model, Board.parse("charuco:5x7:0.030:0.022"))
    with pytest.raises(SettingsError, match="another aspect ratio"):
        locate_camera(image[:400], model, board)
    wrong = dataclasses.replace(model, fx=model.fx * 1.3, distortion=(0.0,) * 5)
    with pytest.raises(SettingsError, match=r"corners are .* px off \(limit 0.64 px\)"):
        locate_camera(image, wrong, board)
    tiny = rendered("charuco:3x3:0.010:0.008", look_at(np.array([0.015, 0.015, 0]), 0.12, 0.3, 0, 0))
    with pytest.raises(SettingsError, match=r"corners of the board|two poses|table is known within"):
        locate_camera(tiny, model, Board.parse("charuco:3x3:0.010:0.008"))
    far = rendered(APRILTAG, view_of(APRILTAG, 1.6, 0.1))
    with pytest.raises(SettingsError, match=r"two poses|table is known within|corners of the board"):
        locate_camera(far, model, Board.parse(APRILTAG))
    assert locate_camera(image, model, board).table_std_m < MAX_TABLE_STD_M / 5


@pytest.mark.parametrize(("distance_m", "words"), [(8.0, "two poses that are 5[0-9].. degrees apart"), (0.3, None)])
def test_a_second_pose_that_fits_as_well_is_noticed(monkeypatch, distance_m, words):
    """From afar a plane tilted to one side looks like one tilted to the other (weak perspective)."""
    model = CameraModel(640, 480, 1000 * distance_m, 1000 * distance_m, 320.0, 240.0)
    view = look_at(np.array([0.05, 0.04, 0.0]), distance_m, 0.45, 0.3, 0.0)
    corners_m = np.stack(np.meshgrid(np.arange(5) * 0.025, np.arange(4) * 0.025, [0.0]), axis=-1).reshape(-1, 3)
    noise = np.random.default_rng(0).normal(0, 0.15, (20, 2))
    uv = model.placed(view.position_m, view.rotation).project(corners_m) + noise
    monkeypatch.setattr(locate, "_detect", lambda image, board: (corners_m, uv, 10))
    image = np.zeros((480, 640, 3), np.uint8)
    if words is None:
        found = locate_camera(image, model, Board.parse(CHARUCO)).model
        assert np.linalg.norm(found.position_m - view.position_m) < 0.003
    else:
        with pytest.raises(SettingsError, match=words):
            locate_camera(image, model, Board.parse(CHARUCO))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("charuco", "is given as"),
        ("charuco:7x5:0.03", "is given as"),
        ("chess:7x5:0.03:0.02", "is given as"),
        ("charuco:7:0.03:0.02", "is given as"),
        ("charuco:7x5:a:0.02", "is given as"),
        ("charuco:7x5:0.03:0.02:A:B", "is given as"),
        ("charuco:7x5:30:22", "give meters"),
        ("charuco:7x5:nan:0.02", "give meters"),
        ("charuco:7x5:0.02:0.02", "smaller than its square"),
        ("charuco:1x5:0.03:0.02", "2 to 40"),
        ("charuco:20x20:0.03:0.02", "DICT_5X5_100 has 100 markers, the board needs 200"),
        ("charuco:7x5:0.03:0.02:9x9", "no dictionary"),
    ],
)
def test_other_descriptions_are_refused(text, words):
    with pytest.raises(SettingsError, match=words):
        Board.parse(text)


@pytest.mark.parametrize("text", [CHARUCO, APRILTAG, "charuco:6x8:0.015:0.011:4x4_50"])
def test_the_printed_page_has_the_scale_of_the_board(tmp_path, text):
    board = Board.parse(text)
    assert draw_board(board, tmp_path / "board.png") == "A4"
    page = cv2.imread(str(tmp_path / "board.png"))
    page = cv2.resize(page, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    height, width = page.shape[:2]
    px_per_m = 150 / 0.0254
    # a camera whose pixels are those of the page, one meter away; x to the right and y up as printed
    lens = Lens(
        (width, height),
        np.array([[px_per_m, 0, width / 2 - 0.5], [0, px_per_m, height / 2 - 0.5], [0, 0, 1]]),
        np.zeros(5),
    )
    found = locate_camera(page, model_of(lens, "plumb_bob"), board)
    paper_m = np.array([width, height]) / px_per_m
    corner = found.model.project(np.zeros((1, 3)))[0] / px_per_m
    np.testing.assert_allclose(corner, (paper_m + np.array([-1, 1]) * board.extent_m) / 2, atol=2e-4)
    assert found.model.position_m[2] == pytest.approx(1.0, abs=0.003)
    np.testing.assert_allclose(found.model.world_from_camera_rotation, np.diag([1, -1, -1]), atol=0.02)


def test_the_page_fits_the_paper_or_is_refused(tmp_path):
    assert draw_board(Board.parse("charuco:12x8:0.030:0.022"), tmp_path / "board.pdf") == "A3"
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
    for text, name, words in (("charuco:14x14:0.1:0.08", "a.pdf", "fit on A0"), (CHARUCO, "a.svg", "png or .pdf")):
        with pytest.raises(SettingsError, match=words):
            draw_board(Board.parse(text), tmp_path / name)
        assert not (tmp_path / name).exists()


@pytest.fixture
def photo(tmp_path):
    cv2.imwrite(str(tmp_path / "photo.png"), rendered(CHARUCO, view_of(CHARUCO)))
    matrix = [row.tolist() for row in BARREL.matrix]
    record = {"image_width": 640, "image_height": 480, "camera_matrix": matrix, "dist": BARREL.distortion.tolist()}
    (tmp_path / "calibration.json").write_text(json.dumps(record))
    return tmp_path


def located(folder, *more, board=CHARUCO, output="pose.json"):
    given = [str(folder / "photo.png"), "--camera", str(folder / "calibration.json"), "--board", board]
    return main(["camera", "locate", *given, "-o", str(folder / output), *more])


def test_the_command_writes_a_camera_file_and_a_picture(photo, capsys):
    assert located(photo, "--board-origin", "0.1", "0", "0", "90") == 0
    assert "reprojection error" in capsys.readouterr().out
    camera, view = read_camera(photo / "pose.json"), view_of(CHARUCO)
    x, y, z = view.position_m
    np.testing.assert_allclose(camera.position_m, (0.1 - y, x, z), atol=0.003)
    blue, _, red = cv2.imread(str(photo / "pose.jpg")).astype(int).transpose(2, 0, 1)
    u, v = camera.project(np.array([[0.1, 0.05, 0.0]]))[0].astype(int)  # on the board's x axis
    assert red[v, u] - blue[v, u] > 100
    facts = json.loads((photo / "pose.json").read_text())["facts"]
    assert facts["board"] == CHARUCO
    assert facts["n_corners"] == 24


def test_the_command_names_what_it_cannot_use_and_overwrites_nothing(photo, capsys):
    before = {path.name: path.read_bytes() for path in photo.iterdir()}
    (photo / "calibration.json").rename(photo / "photo.json")
    for arguments, words in (
        ({"output": "pose.txt"}, "must end in .json"),
        ({"output": "photo.json"}, "calibration.json: is missing"),
        ({"board": "charuco:5x7:0.030:0.022"}, "calibration.json: is missing"),
    ):
        assert located(photo, **arguments) == 1
        assert words in capsys.readouterr().err
    (photo / "photo.json").rename(photo / "calibration.json")
    for arguments, words in (
        ({"output": "calibration.json"}, "calibration.json: would be overwritten"),
        ({"board": "charuco:5x7:0.030:0.022"}, "photo.png: shows"),
        ({"board": "charuco:5x7"}, "is given as"),
    ):
        assert located(photo, **arguments) == 1
        assert words in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in photo.iterdir()} == before
    assert main(["camera", "board", "-o", str(photo / "board.pdf")]) == 0
    assert main(["camera", "board", "-o", str(photo / "board.gif")]) == 1
