"""Whether what is left comes in a burst: a band's noise is told by its mean power over a run, and hides what is short.

What lasts some ten milliseconds in one run has power at all frequencies, so all bands of that run come out a little
noisier, and nothing is left. Over time it stands many times above what the same run has elsewhere.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.robust import over_time
from hil_forceps.diagnosis.spectrum import JAW, Flat, Layout, Part

ROWS, EVERY = 64, 16  # of a window, and from one to the next
COUNTS = 0.5  # of a row's weight: less is the fading at a run's ends
# Of χ². In the jaw's angle: the motor's holds the encoder's rounding, which comes in bursts. A limit that went for
# noise had 326; a jump of the load that is too small to be found has up to 155: worth a word, and no verdict.
STANDS_OUT = 120.0


class Burst(NamedTuple):
    """The window of all runs in which the jaw's residual is least like the rest of its run."""

    run: int
    first: int  # row
    times: float  # its power over the run's mean
    gain: float  # of χ², by noise that is as high there

    @property
    def stands_out(self) -> bool:
        """Whether it is more than noise gives."""
        return self.gain > STANDS_OUT


def burst_of(layout: Layout, residual: Flat) -> Burst | None:
    """Return the strongest burst of a whitened residual; None where no jaw was measured long enough."""
    found = [burst for part in layout.parts if part.channel == JAW and (burst := _of_part(part, residual)) is not None]
    return max(found, key=lambda burst: burst.gain, default=None)


def _of_part(part: Part, residual: Flat) -> Burst | None:
    squares = over_time(residual[part.start : part.stop, None], part.rows)[:, 0].astype(np.float64) ** 2
    power, weight = _sums(squares), _sums(part.weights**2)
    whole = weight > COUNTS * ROWS
    if np.count_nonzero(whole) < 2 * ROWS // EVERY:
        return None
    times = power[whole] / weight[whole] * (np.sum(part.weights**2) / np.sum(squares))
    gains = np.where(times > 1.0, ROWS * (times - 1.0 - np.log(np.maximum(times, 1e-300))), 0.0)
    best = int(np.argmax(gains))
    return Burst(part.run, int(np.flatnonzero(whole)[best]) * EVERY, float(times[best]), float(gains[best]))


def _sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum over each window."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    first = np.arange(0, max(values.size - ROWS + 1, 0), EVERY)
    return np.asarray(total[first + ROWS] - total[first])
