"""What a drive counted and followed between rows, from the current that the next row shows.

A drive that samples more often than rows are logged counts its encoder where no row shows it, and its law makes of a
count more or less a step of the current that a row may show. Its reference there may be still that of the row, already
that of the next row, or in between: a host's references arrive when they arrive.

Each pair of a count and a kind of reference is weighed by how likely the count is about the angle that is expected
there, and by how well its command fits the measured current. The command is the mean over all pairs, with its
variance; what pairs leave open of the drive's integral adds up, and is followed by a scalar Kalman filter. Which kind
of reference holds around a row is told by the likelihood of each over a window: a wrong kind makes the integral drift.

Only where the command is known without it is the current a measurement: chosen by it, commands fit it too well.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from hil_forceps.diagnosis.state_space.kernel import kernel
from hil_forceps.diagnosis.state_space.layout import OMEGA_M, THETA_M
from hil_forceps.model.drive_law import KI, LIMIT, SAMPLE_TIME, DriveState, drive_sample

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

REACH = 3  # counts to either side of the expected angle that a count may be
LINE_SD = 0.6  # counts: of a count about the line between its neighbours  # tuned: one set of four runs
LEAST_SD = 0.1  # counts: of the angle that the filter expects, at least: its course has errors of its own
MOST_MISFIT = 100.0  # χ²: a blow to the current sensor is no proof of a count
SURE_SHARE = 0.01  # of the variance of the current's noise: a command open by less is known without
WINDOW_S = 0.5  # over which the kind of reference is taken to be the same
LEAST_WEIGHT = 1e-3  # of a kind of reference that never held around a row


class Expected(NamedTuple):
    """The motor's angle between rows as far as it is known without the current."""

    angle_rad: Vector  # n · samples
    deviation_rad: float


class Decoded(NamedTuple):
    """What the drive commanded."""

    command_A: Vector  # n · samples
    variance: Vector  # n [A²]: of their mean over a row
    bias_variance: Vector  # n [A²]: of what a row adds to what the integral is off
    sure: NDArray[np.bool_]  # n: the current of this row isn't what decided
    log_likelihood: Vector  # n: of the current of the next row


class _Rows(NamedTuple):
    """What was recorded, n each."""

    reference: Vector
    encoder: Vector
    current: Vector


class _Drive(NamedTuple):
    """The drive and its sensors."""

    law: Vector
    samples: int
    quantum: float
    noise_sd: float


@kernel
def _weigh(
    v: _Drive,
    state: DriveState,
    aims: tuple[float, float, float],
    angle: tuple[float, float, float],
    shown: tuple[float, float],
    prior: Vector,
    weights: Matrix,
    values: Matrix,
) -> tuple[float, float]:
    """Fill the likelihood of each kind of reference and count, and its command.

    Returned are the sum of the former, and the variance of the command by what is known without the current.

    `angle`: as expected, its deviation, and its count; `shown`: what the next row shows of the command, or NaN, and its
    deviation.
    """
    total, reach = 0.0, values.shape[1] // 2
    before, mean, square = 0.0, 0.0, 0.0
    for kind in range(3):
        for k in range(values.shape[1]):
            tried = angle[2] + (k - reach) * v.quantum
            values[kind, k] = drive_sample(v.law, state, aims[kind], tried).current_A
            likely = prior[kind]
            if v.quantum > 0.0:
                likely *= _count_probability(tried, v.quantum, angle[0], angle[1])
            before += likely
            mean += likely * values[kind, k]
            square += likely * values[kind, k] ** 2
            if not math.isnan(shown[0]):
                misfit = (shown[0] - values[kind, k]) / shown[1]
                likely *= math.exp(-0.5 * min(misfit * misfit, MOST_MISFIT))
            weights[kind, k] = likely
            total += likely
    if total <= 0.0:  # nothing fits: what was expected, then
        weights[:, reach] = prior
    weights /= weights.sum()
    if before <= 0.0:
        return 1e-300, math.inf
    return max(total, 1e-300), max(0.0, square / before - (mean / before) ** 2)


@kernel
def _decode(v: _Drive, d: _Rows, angle: Vector, deviation: float, prior: Matrix, integral: float, out: Decoded) -> None:
    n = d.encoder.size
    state, bias, open_variance = DriveState(integral, math.nan, 0.0, d.current[0]), 0.0, v.law[LIMIT] ** 2
    if v.law[KI] <= 0.0:
        open_variance = 0.0
    reach = REACH if v.quantum > 0.0 else 0
    weights, values = np.zeros((3, 2 * reach + 1)), np.zeros((3, 2 * reach + 1))
    per_rad = v.law[KI] * v.law[SAMPLE_TIME]
    for row in range(n):
        state = drive_sample(v.law, state, d.reference[row], d.encoder[row])
        out.command_A[row * v.samples] = state.current_A + bias
        out.variance[row], out.bias_variance[row], out.log_likelihood[row] = 0.0, 0.0, 0.0
        ahead = min(row + 1, n - 1)
        for sample in range(1, v.samples):
            expected = angle[row * v.samples + sample]
            count = math.floor(expected / v.quantum + 0.5) * v.quantum if v.quantum > 0.0 else expected
            line = d.reference[row] + sample / v.samples * (d.reference[ahead] - d.reference[row])
            aims = (d.reference[row], d.reference[ahead], line)
            last = sample == v.samples - 1 and row < n - 1
            shown = d.current[ahead] - bias if last else math.nan
            spread_A = math.sqrt(v.noise_sd**2 + open_variance)
            near = (expected, deviation, count)
            total, known = _weigh(v, state, aims, near, (shown, spread_A), prior[row], weights, values)
            mean = np.sum(weights * values)
            spread = np.sum(weights * (values - mean) ** 2)
            best = np.argmax(weights)
            kind, k = best // weights.shape[1], best % weights.shape[1]
            counted = count + (k - reach) * v.quantum
            state = drive_sample(v.law, state, aims[kind], counted)
            out.command_A[row * v.samples + sample] = mean + bias
            out.variance[row] += spread / (v.samples * v.samples)
            off = per_rad * per_rad * _error_variance(weights, aims, count, v.quantum, aims[kind] - counted)
            if last:
                out.log_likelihood[row] = math.log(total / spread_A)
                out.sure[ahead] = known < SURE_SHARE * v.noise_sd * v.noise_sd
                gain = open_variance / (v.noise_sd**2 + spread + open_variance)
                bias += gain * (shown - mean)
                open_variance *= 1.0 - gain
            out.bias_variance[row] += off
            open_variance += off


@kernel
def _error_variance(
    weights: Matrix, aims: tuple[float, float, float], count: float, quantum: float, taken: float
) -> float:
    """Return the mean square by which the drive's error is off, where the likeliest pair is taken."""
    reach, total = weights.shape[1] // 2, 0.0
    for kind in range(3):
        for k in range(weights.shape[1]):
            total += weights[kind, k] * (aims[kind] - count - (k - reach) * quantum - taken) ** 2
    return total


@kernel
def _count_probability(count: float, quantum: float, angle: float, deviation: float) -> float:
    """Return how likely an angle of this mean and deviation is counted so."""
    scale = 1.0 / (deviation * math.sqrt(2.0))
    low, high = (count - 0.5 * quantum - angle) * scale, (count + 0.5 * quantum - angle) * scale
    probability: float = 0.5 * (math.erfc(low) - math.erfc(high))
    return max(probability, 0.0)


def decoded(
    law: Vector,
    samples: int,
    quantum: float,
    noise_sd: float,
    period_s: float,
    rows: tuple[Vector, Vector, Vector],
    expected: Expected | None = None,
    first_integral: float = 0.0,
) -> Decoded:
    """Return what a drive commanded; `rows`: its reference, count and measured current.

    `expected`: the angle between rows; by default on the line between their counts. `first_integral`: of the law at the
    first row [rad s]; what it is off by is followed.
    """
    reference, encoder, current = rows
    n = encoder.size
    if expected is None:
        expected = Expected(on_lines(encoder, samples), LINE_SD * quantum)
    drive, given = _Drive(law, samples, quantum, max(noise_sd, 1e-9)), _Rows(reference, encoder, current)
    deviation = max(expected.deviation_rad, LEAST_SD * quantum)

    def decode(prior: Matrix) -> Decoded:
        zeros = [np.zeros(n) for _ in range(3)]
        out = Decoded(np.zeros(n * samples), zeros[0], zeros[1], np.zeros(n, dtype=np.bool_), zeros[2])
        _decode(drive, given, expected.angle_rad, deviation, prior, first_integral, out)
        return out

    each = [decode(np.tile(kind, (n, 1))).log_likelihood for kind in np.eye(3)]
    window = max(3, round(WINDOW_S / period_s))
    around = window * np.stack([uniform_filter1d(likelihood, window) for likelihood in each], axis=1)
    prior = np.exp(np.maximum(around - around.max(axis=1, keepdims=True), math.log(LEAST_WEIGHT)))
    return decode(prior / prior.sum(axis=1, keepdims=True))


def on_lines(values: Vector, samples: int) -> Vector:
    """Return values at each sample of the drive, on lines between rows."""
    return np.asarray(np.interp(np.arange(values.size * samples) / samples, np.arange(values.size), values))


def between_rows(course: Matrix, deviation_rad: float, period_s: float, samples: int) -> Expected:
    """Return the angle between rows by the filter: a cubic with its angles and speeds at the rows (Hermite)."""
    angle, way = course[:, THETA_M], period_s * course[:, OMEGA_M]
    after, way_after = np.append(angle[1:], angle[-1] + way[-1]), np.append(way[1:], way[-1])
    found = np.empty(angle.size * samples)
    for sample in range(samples):
        s = sample / samples
        found[sample::samples] = (
            (1.0 + 2.0 * s) * (1.0 - s) ** 2 * angle
            + s * (1.0 - s) ** 2 * way
            + s * s * (3.0 - 2.0 * s) * after
            - s * s * (1.0 - s) * way_after
        )
    return Expected(found, deviation_rad)
