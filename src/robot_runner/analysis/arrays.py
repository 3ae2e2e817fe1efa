"""Arrays of numbers, as signatures name them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Places, codes and counts.
Numbers = NDArray[np.intp]
