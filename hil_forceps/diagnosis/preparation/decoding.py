"""What a drive counted between rows, from the current that the next row shows.

A drive that samples more often than rows are logged counts its encoder where no row shows it, and its law makes of a
count more or less a step of the current that a row may show. So the counts between two rows are those on the line
between both, but for the last of them, which is weighed by how well its command fits the measured current: the command
is the mean over the counts that it may have been, and its variance is known.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.state_space.kernel import kernel
from hil_forceps.model.drive_law import KI, DriveState, drive_sample

Vector = NDArray[np.float64]

_REACH = 3  # counts to either side of the line that the last one may be
_LINE_SD = 0.6  # counts: of a true angle's count about its neighbours' line  # tuned: one set of four runs
_BIAS_GAIN = 0.02  # of an error of the current, into the integral at the start  # tuned: the same set


@kernel
def decoded(
    law: Vector, samples: int, quantum: float, noise_sd: float, reference: Vector, encoder: Vector, current: Vector
) -> tuple[Vector, Vector]:
    """Return commands (n · samples) and the variance of their mean over each row (n) [A²]."""
    n = encoder.size
    commands, variance = np.zeros(n * samples), np.zeros(n)
    state = DriveState(0.0, math.nan, 0.0, current[0])
    bias = 0.0
    width = 2 * _REACH + 1
    weights, values = np.zeros(width), np.zeros(width)
    for row in range(n):
        state = drive_sample(law, state, reference[row], encoder[row])
        commands[row * samples] = state.current_A
        ahead = min(row + 1, n - 1)
        for sample in range(1, samples):
            share = sample / samples
            aim = reference[row] + share * (reference[ahead] - reference[row])
            line = encoder[row] + share * (encoder[ahead] - encoder[row])
            counted = math.floor(line / quantum + 0.5) * quantum if quantum > 0.0 else line
            if sample < samples - 1 or quantum <= 0.0 or row == n - 1:
                state = drive_sample(law, state, aim, counted)
                commands[row * samples + sample] = state.current_A
                continue
            total, mean, best, at = 0.0, 0.0, -1.0, 0
            for k in range(width):
                angle = counted + (k - _REACH) * quantum
                values[k] = drive_sample(law, state, aim, angle).current_A
                away = (angle - line) / (_LINE_SD * quantum)
                misfit = (current[ahead] - values[k] - bias) / noise_sd if noise_sd > 0.0 else 0.0
                weights[k] = math.exp(-0.5 * (away * away + min(misfit * misfit, 100.0)))
                total += weights[k]
                mean += weights[k] * values[k]
                if weights[k] > best:
                    best, at = weights[k], k
            mean /= total
            spread = 0.0
            for k in range(width):
                spread += weights[k] * (values[k] - mean) ** 2 / total
            state = drive_sample(law, state, aim, counted + (at - _REACH) * quantum)
            commands[row * samples + sample] = mean
            variance[row] = spread / (samples * samples)
            # The integral at the start isn't known: what commands lack on the mean.
            bias += _BIAS_GAIN * (current[ahead] - mean - bias) if law[KI] > 0.0 else 0.0
    return commands, variance
