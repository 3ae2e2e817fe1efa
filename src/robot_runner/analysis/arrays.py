"""Types of arrays of numbers, for signatures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Indices, codes and counts.
Numbers = NDArray[np.intp]
