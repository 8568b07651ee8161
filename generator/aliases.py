"""Type aliases that several modules share."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Quads = NDArray[np.int64]
Rgb = tuple[float, float, float]
Point = tuple[float, float, float]
