"""The array types that all floors share."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
CountArray = NDArray[np.uint32]
BoolArray = NDArray[np.bool_]
