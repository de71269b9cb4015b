"""Where a mass slides for sure: its angle goes one way by a count at least in each quarter of a window, and on."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_opening, maximum_filter1d, minimum_filter1d, uniform_filter1d

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

QUARTERS_ROWS = (
    1,
    2,
    4,
    10,
)  # rows of a quarter: down to a count in ten rows  # tuned: chirps and holds, 10 % friction
SLOW_QUARTER_ROWS = 25  # rows, beside those for a sensor that is noisy
TURN_DEVIATIONS = 3.0  # deviations of the difference of two quarters' means; four of them must be
DWELL_ROWS = 50  # to either side: an encoder within two counts as long dwells  # tuned: frictionless holds


def may_stick(angle_rad: Vector, step_rad: float, margin: int) -> Mask:
    """Return where a mass may stick from a row to the next; `margin`: rows before and behind that are left out, too.

    `step_rad`: by how much the angle must change to be sure, a count of its encoder.
    """
    return _may_stick([(quarter, angle_rad, 0.9 * step_rad) for quarter in QUARTERS_ROWS], margin)


def may_stick_by_sensor(angle_rad: Vector, noise_rad: float, margin: int) -> Mask:
    """Return the same by an angle that is measured with white noise: means of quarters must differ beyond chance."""
    means = [(quarter, uniform_filter1d(angle_rad, quarter)) for quarter in (*QUARTERS_ROWS, SLOW_QUARTER_ROWS)]
    return _may_stick([(q, mean, TURN_DEVIATIONS * noise_rad * np.sqrt(2.0 / q)) for q, mean in means], margin)


def _may_stick(looks: Sequence[tuple[int, Vector, float]], margin: int) -> Mask:
    """Return where none of some looks is sure; each has the rows of a quarter, an angle, and the least change of it."""
    sliding = np.zeros(looks[0][1].size, dtype=np.bool_)
    for quarter, angle_rad, least_rad in looks:
        held = np.pad(angle_rad, 2 * quarter, mode="edge")
        n = angle_rad.size
        changes = np.stack(
            [held[(i + 1) * quarter : (i + 1) * quarter + n] - held[i * quarter : i * quarter + n] for i in range(4)]
        )
        for one_way in (np.all(changes >= least_rad, axis=0), np.all(changes <= -least_rad, axis=0)):
            sliding |= binary_opening(one_way, np.ones(4 * quarter + 1, dtype=np.bool_))
    return np.asarray(binary_dilation(~sliding, np.ones(2 * margin + 1, dtype=np.bool_)))


def dwelling(encoder_rad: Vector, count_rad: float) -> Mask:
    """Return the rows around which the encoder shows no more than two neighbouring counts for a while."""
    width = 2 * DWELL_ROWS + 1
    if count_rad <= 0.0 or encoder_rad.size < width:
        return np.zeros(encoder_rad.size, dtype=np.bool_)
    span = maximum_filter1d(encoder_rad, width) - minimum_filter1d(encoder_rad, width)
    return np.asarray(maximum_filter1d((span < 1.5 * count_rad).astype(np.uint8), width).astype(np.bool_))
