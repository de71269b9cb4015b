"""Models on runs: what each says beside what was measured, and what extending gained on runs that were never used."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.result import Gain, RunEvidence
from hil_forceps.diagnosis.validation.rows import Rows

Vector = NDArray[np.float64]

BLOCK_S = 0.5  # of the bootstrap: longer than residuals remember
DRAWS = 1000
DIVERGED_SPANS = 10.0  # of a measured channel: a simulation that goes further has left the run


class Played(NamedTuple):
    """A model played beside runs: simulated channels and courses of each."""

    channels: list[dict[str, Vector]]
    courses: list[Course]


def gains(
    records: Sequence[Rows], before: Played, after: Played, floors: dict[str, float], seed: int
) -> dict[str, Gain]:
    """Return what the extension gained, channel by channel, with a block bootstrap."""
    rng = np.random.default_rng(seed)
    found = {}
    for name in dict.fromkeys(name for record in records for name in record.channels):
        first, second = [], []
        for k, record in enumerate(records):
            if name in record.channels:
                first += blocks(record, record.channels[name] - before.channels[k][name])
                second += blocks(record, record.channels[name] - after.channels[k][name])
        found[name] = gain_of(np.array(first), np.array(second), floors.get(name, 0.0), rng)
    return found


def blocks(record: Rows, residual: Vector) -> list[tuple[float, float]]:
    """Return sum of squares and count of the rows that count, block by block, for `gain_of`."""
    rows = max(1, round(BLOCK_S / record.period_s))
    squares = residual**2 * record.weights
    starts = np.arange(0, residual.size, rows)
    return list(zip(np.add.reduceat(squares, starts), np.add.reduceat(record.weights, starts), strict=True))


def gain_of(first: Vector, second: Vector, floor: float, rng: np.random.Generator) -> Gain:
    """Return the gain from blocks (m×2) before and after, with a bootstrap over the blocks; `floor`: rms of noise."""

    def share(picked: NDArray[np.intp]) -> tuple[float, float, float]:
        count = max(float(first[picked, 1].sum()), 1.0)
        e0, e1 = float(first[picked, 0].sum()) / count, float(second[picked, 0].sum()) / count
        room = e0 - min(floor**2, e0, e1)
        return e0, e1, (e0 - e1) / room if room > 1e-12 * e0 and e0 > 0.0 else 0.0

    whole = np.arange(first.shape[0])
    e0, e1, value = share(whole)
    drawn = [share(rng.choice(whole, whole.size))[2] for _ in range(DRAWS)]
    low, high = np.quantile(drawn, (0.025, 0.975))
    least = float(np.sqrt(min(floor**2, e0, e1)))
    return Gain(float(np.sqrt(e0)), float(np.sqrt(e1)), least, value, float(low), float(high))


def evidence(
    records: Sequence[Rows],
    held_out: bool,
    nominal: Played,
    before: Played,
    after: Played,
    estimated: Sequence[Mapping[str, Vector]],
) -> list[RunEvidence]:
    """Return the runs for the figures."""
    return [
        RunEvidence(
            record.name,
            held_out,
            record.time_s,
            _shown(record) | ({"tau_w_N_m": record.tau_w_N_m} if record.tau_w_N_m is not None else {}),
            before.channels[k],
            after.channels[k],
            nominal.channels[k],
            variables_of(after.courses[k]),
            estimated[k],
        )
        for k, record in enumerate(records)
    ]


def _shown(rows: Rows) -> dict[str, Vector]:
    """Return the channels of a run that figures show: those compared, and the motion that drives it."""
    return ({"theta_m_rad": rows.reference_rad} if rows.driven else {}) | dict(rows.channels)


def variables_of(course: Course) -> dict[str, Vector]:
    """Return the variables over which residuals are shown."""
    return {
        "theta": course.theta_m,
        "omega": course.omega_m,
        "tension": course.tension_N,
        "time": course.time_s,
        "time_since_reversal": _since_reversal(course.omega_m, course.period_s),
        "load": course.load_N_m,
        "acceleration": np.gradient(course.omega_m, course.period_s),
    }


def _since_reversal(omega: Vector, period_s: float) -> Vector:
    moving = np.abs(omega) > 0.02 * max(float(np.abs(omega).max()), 1e-9)
    sign = np.where(moving, np.sign(omega), 0.0)
    held = np.maximum.accumulate(np.where(moving, np.arange(omega.size), 0))
    sign = sign[held]
    turned = np.concatenate(([0], np.flatnonzero(np.diff(sign) != 0.0) + 1))
    last = np.zeros(omega.size, dtype=np.intp)
    last[turned] = turned
    return np.asarray((np.arange(omega.size) - np.maximum.accumulate(last)) * period_s)
