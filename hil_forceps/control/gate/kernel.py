"""The compiler of the gate's kernels: loops over its laws of single samples and requests, which stand once.

They find the first of many that does not simply pass (`Gate.follow`); all else is the gate's own.
"""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.kernels.compiler import kernel_compiler

Vector = NDArray[np.float64]

kernel = kernel_compiler(("hil_forceps/control/gate",))
