"""Calibration boards of fiducial markers: their description in one line, their points, and a page to print."""

import dataclasses
import functools
import pathlib
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.io.storage import atomic_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

DICTIONARIES = {"charuco": "DICT_5X5_100", "apriltag": "DICT_APRILTAG_36h11"}
SYNTAX = "charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY] or apriltag:COLUMNSxROWS:TAG:GAP[:DICTIONARY], in meters"
SMALLEST_M, LARGEST_M, MOST = 0.002, 1.0, 40

PAGES_MM = {"A4": (297, 210), "A3": (420, 297), "A2": (594, 420), "A1": (841, 594), "A0": (1189, 841)}
MARGIN_MM, CAPTION_MM, RULER_MM = 8, 18, 100
DPI = 300
PX_PER_MODULE = 40
MM_PER_INCH = 25.4


@dataclasses.dataclass(frozen=True)
class Board:
    """A board of ``columns`` x ``rows`` squares (ChArUco) or tags (AprilTag grid).

    Its frame is that of the printed page: the origin is the lower left corner of the pattern, x points right, y up
    along the page, and z out of it.

    Attributes:
        kind: ``charuco`` or ``apriltag``.
        columns, rows: number of squares or tags.
        size_m: edge of a square or tag.
        inner_m: edge of the marker in a square, or gap between tags.
        dictionary: OpenCV's name of the set of markers.

    Raises:
        SettingsError: a value is outside its domain, or the dictionary has too few markers.
    """

    kind: str
    columns: int
    rows: int
    size_m: float
    inner_m: float
    dictionary: str

    def __post_init__(self) -> None:
        if self.kind not in DICTIONARIES:
            raise SettingsError(f"a board is one of {list(DICTIONARIES)}, got {self.kind!r:.40}")
        if not (2 <= self.columns <= MOST and 2 <= self.rows <= MOST):
            raise SettingsError(f"a board needs 2 to {MOST} columns and rows, got {self.columns} x {self.rows}")
        for name, value in (("size", self.size_m), ("marker or gap", self.inner_m)):
            if not SMALLEST_M <= value <= LARGEST_M:
                raise SettingsError(f"the {name} must be {SMALLEST_M:g} to {LARGEST_M:g} m, got {value:g}; give meters")
        if self.kind == "charuco" and self.inner_m >= self.size_m:
            raise SettingsError(f"a marker must be smaller than its square, got {self.inner_m:g} and {self.size_m:g} m")
        known, needed = len(_dictionary(self.dictionary).bytesList), self.n_markers
        if known < needed:
            raise SettingsError(f"{self.dictionary} has {known} markers, the board needs {needed}; name a larger one")

    @classmethod
    def parse(cls, text: str) -> "Board":
        """Read a description such as ``charuco:7x5:0.030:0.022`` or ``apriltag:4x3:0.040:0.010:DICT_APRILTAG_25h9``.

        Raises:
            SettingsError: the text is not of this form, or describes no valid board.
        """
        kind, *rest = text.split(":")
        try:
            count, size_m, inner_m, *named = rest
            columns, rows = map(int, count.lower().split("x"))
            (dictionary,) = named or [DICTIONARIES[kind]]
            values = float(size_m), float(inner_m)
        except (ValueError, KeyError) as error:
            raise SettingsError(f"a board is given as {SYNTAX}, got {text!r:.80}") from error
        return cls(kind, columns, rows, *values, dictionary)

    @property
    def n_markers(self) -> int:
        """Number of markers."""
        return self.columns * self.rows if self.kind == "apriltag" else self.columns * self.rows // 2

    @property
    def extent_m(self) -> tuple[float, float]:
        """Width and height of the pattern."""
        if self.kind == "charuco":
            return self.columns * self.size_m, self.rows * self.size_m
        pitch_m = self.size_m + self.inner_m
        return self.columns * pitch_m - self.inner_m, self.rows * pitch_m - self.inner_m

    @functools.cached_property
    def opencv(self) -> Any:
        """The board as an object of OpenCV, whose frame has y down the page and z into it."""
        size, markers = (self.columns, self.rows), _dictionary(self.dictionary)
        make = cv2.aruco.CharucoBoard if self.kind == "charuco" else cv2.aruco.GridBoard
        return make(size, self.size_m, self.inner_m, markers)

    @functools.cached_property
    def legacy(self) -> Any:
        """The ChArUco board as OpenCV before 4.6 and other generators draw it: with a white square at the top left."""
        board = cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.size_m, self.inner_m, _dictionary(self.dictionary)
        )
        board.setLegacyPattern(True)
        return board

    def from_opencv(self, points_m: Array) -> Array:
        """Convert points (N, 3) from OpenCV's frame of the board to the page's."""
        return np.asarray(points_m, np.float64).reshape(-1, 3) * (1, -1, -1) + (0, self.extent_m[1], 0)

    def pattern(self) -> NDArray[np.uint8]:
        """Draw the pattern without a margin."""
        pixels = [round(length / self.size_m * 8 * PX_PER_MODULE) for length in self.extent_m]
        return np.asarray(self.opencv.generateImage(pixels, marginSize=0), np.uint8)


def _dictionary(name: str) -> Any:
    known = {each.upper(): each for each in dir(cv2.aruco) if each.startswith("DICT_")}
    key = name.upper() if name.upper().startswith("DICT_") else f"DICT_{name.upper()}"
    if key not in known:
        raise SettingsError(f"there is no dictionary {name!r:.40}; OpenCV has {', '.join(sorted(known.values()))}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, known[key]))


def draw_board(board: Board, destination: str | pathlib.Path) -> str:
    """Write a page to print at 100 %, with the board's axes and a ruler; return the paper's name.

    Raises:
        SettingsError: the file ends neither in .png nor in .pdf, or the board does not fit on A0.
        WriteError: no space or no permission.
    """
    destination = pathlib.Path(destination)
    if destination.suffix.lower() not in (".png", ".pdf"):
        raise SettingsError(f"a board is written as .png or .pdf, got {destination.name}")
    width_mm, height_mm = (1000 * length for length in board.extent_m)
    needed_mm = width_mm + 2 * MARGIN_MM, height_mm + 2 * MARGIN_MM + 2 * CAPTION_MM
    for name, (long_mm, short_mm) in PAGES_MM.items():
        for page_mm in ((long_mm, short_mm), (short_mm, long_mm)):
            if needed_mm[0] <= page_mm[0] and needed_mm[1] <= page_mm[1]:
                figure = _page(board, name, page_mm)
                with atomic_file(destination) as temporary:
                    metadata = {"CreationDate": None} if destination.suffix.lower() == ".pdf" else {"Software": None}
                    figure.savefig(temporary, dpi=DPI, metadata=metadata)
                return name
    raise SettingsError(f"a board of {width_mm:g} x {height_mm:g} mm does not fit on A0; make it smaller")


def _page(board: Board, paper: str, page_mm: tuple[float, float]) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(page_mm[0] / MM_PER_INCH, page_mm[1] / MM_PER_INCH))
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set_axis_off()
    width_mm, height_mm = (1000 * length for length in board.extent_m)
    left, low = (page_mm[0] - width_mm) / 2, (page_mm[1] - height_mm) / 2
    ax.set_xlim(-left, page_mm[0] - left)
    ax.set_ylim(-low, page_mm[1] - low)
    ax.imshow(
        board.pattern(),
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=(0, width_mm, 0, height_mm),
        interpolation="none",
        aspect="auto",
    )
    _draw_axes(ax)
    ruler = -CAPTION_MM + 6
    ax.plot((width_mm - RULER_MM, width_mm), (ruler, ruler), color="black", lw=0.8)
    for tick in range(0, RULER_MM + 1, 10):
        ax.plot((width_mm - tick,) * 2, (ruler, ruler + (3 if tick % 50 == 0 else 1.8)), color="black", lw=0.8)
    ax.text(width_mm - RULER_MM / 2, ruler - 1.5, f"{RULER_MM} mm", ha="center", va="top", fontsize=8)
    text = f"{board.kind}:{board.columns}x{board.rows}:{board.size_m:g}:{board.inner_m:g}:{board.dictionary}"
    ax.text(0, height_mm + 4, f"{text}   print on {paper} at 100 %, measure the ruler", fontsize=8, va="bottom")
    return figure


def _draw_axes(ax: "Axes") -> None:
    """Mark the origin and the directions of x and y, with a white border around the pattern."""
    for name, start, tip in (("x", (4, -6), (20, -6)), ("y", (-6, 4), (-6, 20))):
        ax.annotate("", tip, start, arrowprops={"arrowstyle": "->", "lw": 1.0})
        ax.annotate(name, tip, xytext=(4, -3) if name == "x" else (-3, 4), textcoords="offset points", fontsize=9)
    ax.annotate("origin", (-0.5, -0.5), (-7, -9), ha="center", fontsize=8, arrowprops={"arrowstyle": "->", "lw": 0.8})
