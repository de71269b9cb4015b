"""What the encoder's rounding does to the motor, as it happened in each run."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.dwells import FASTEST_HZ, dwell_errors
from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.predict import ClosedLoop, Offset, Slow, between_rows, low_pass, samples_per_row
from hil_forceps.diagnosis.problem import Nuisance
from hil_forceps.diagnosis.smoothing import slow_noise, white_deviation
from hil_forceps.model.closed_loop import Channels

Vector = NDArray[np.float64]

SLOWEST_SHAKE_HZ = 120.0  # below, what is left is misfit rather than rounding
SHAKE_PASSES = 5
STAND_IN_SHARE = 0.37  # of a run: how far the rounding is moved that stands in for the one that happened
SWING = 100.0  # of the noise that smoothing leaves in the load: how far the load of stand-ins is swung
MOST_SWING = 0.15  # of the load's own standard deviation


class _Rounding(NamedTuple):
    """The fast part of a run's rounding as it happened, and the run without and with it."""

    error_rad: Vector  # one for each sample of the drive
    plain: Channels
    shaken: Channels


def with_encoder_errors(
    loop: ClosedLoop, theta: Vector, nuisances: Sequence[Nuisance], quantum_rad: float, mapper: Mapper = map
) -> ClosedLoop:
    """Return the same with the encoder's rounding as it happened: the fast part of what a fit leaves in θ_m.

    Its offset is what this does more than the roundings that stand in for it, at `theta` and `nuisances`.
    """
    runs = range(len(loop.records))
    still = loop.unshaken()
    each = list(mapper(lambda k: _rounding(still, k, theta, nuisances[k], quantum_rad), runs))
    slow = _slow_shares(still, theta, nuisances, quantum_rad, each, mapper)
    found = replace(still, encoder_error_rad=tuple(one.error_rad for one in each), slow=slow)
    found = replace(found, stand_ins=_stand_ins(found))
    offsets = mapper(lambda k: _offset(found, k, theta, nuisances[k], each[k].shaken), runs)
    return replace(found, offset=tuple(offsets))


def _rounding(still: ClosedLoop, run: int, theta: Vector, nuisance: Nuisance, quantum_rad: float) -> _Rounding:
    """Return the fast part of a run's rounding, with the plant at `theta`."""
    plain = shaken = still.raw(run, theta, nuisance)
    error: Vector = np.empty(0)
    for _ in range(SHAKE_PASSES):
        # What is left holds the motor's answer to the rounding too, as long as the simulation doesn't answer to it.
        error = _fast_left(still, run, shaken.theta_m_rad, quantum_rad)
        alone = (*still.encoder_error_rad[:run], error, *still.encoder_error_rad[run + 1 :])
        shaken = replace(still, encoder_error_rad=alone).raw(run, theta, nuisance)
    return _Rounding(error, plain, shaken)


def _fast_left(loop: ClosedLoop, run: int, theta_m_rad: Vector, quantum_rad: float) -> Vector:
    """Return the fast part of what a simulation leaves in θ_m, no more than rounding can be."""
    record = loop.records[run]
    left = record.channels["theta_m_rad"] - theta_m_rad
    fast = left - low_pass(left, averaged_rows(SLOWEST_SHAKE_HZ, record.period_s))
    error = np.asarray(np.clip(fast, -0.5 * quantum_rad, 0.5 * quantum_rad))
    return counted_between(
        record.channels["theta_m_rad"] - error, error, samples_per_row(record, loop.law), quantum_rad
    )


def counted_between(angle: Vector, error: Vector, samples: int, quantum_rad: float) -> Vector:
    """Return the rounding at each sample of the drive: as it is at rows, and as an angle between them is counted."""
    if samples == 1:
        return error
    between = between_rows(angle, samples, "smooth")
    found = np.rint(between / quantum_rad) * quantum_rad - between
    found[::samples] = error
    return np.asarray(found)


def _offset(loop: ClosedLoop, run: int, theta: Vector, nuisance: Nuisance, shaken: Channels) -> Offset:
    """Return what the rounding of a run does more than those that stand in for it; `shaken`: without its slow part."""
    first, second = (stand_in.raw(run, theta, nuisance) for stand_in in loop.stand_ins)
    mean_m, mean_j, mean_A = (
        0.5 * (getattr(first, name) + getattr(second, name)) for name in ("theta_m_rad", "theta_j_rad", "current_A")
    )
    slow = loop.slow[run]
    motor = shaken.theta_m_rad + slow.theta_m_rad - mean_m
    jaw = shaken.theta_j_rad + slow.theta_j_rad - mean_j
    # Others' roundings cancel, and the slow part isn't what the drive has read on the average.
    read = motor - slow.theta_m_rad + loop.error_at_rows(run)
    return Offset(motor, jaw, shaken.current_A - mean_A, np.cumsum(read) * loop.records[run].period_s)


def _stand_ins(loop: ClosedLoop) -> tuple[ClosedLoop, ...]:
    """Return the same with a calm load, swung up and down, and the rounding of another time with either sign.

    Without the swing, what the load's noise leads to where the wire is all but slack would be in the sensitivities too,
    with the sign that this noise happens to have: as that is in the residual as well, a dead zone came out too narrow.
    Both signs together leave such instants to those that are sure.
    """
    calm = loop.calmed()
    moved = [np.roll(error, round(STAND_IN_SHARE * error.size)) for error in loop.encoder_error_rad]
    return tuple(
        replace(
            calm,
            records=tuple(_swung(record, sign) for record in calm.records),
            encoder_error_rad=tuple(sign * error for error in moved),
        )
        for sign in (1.0, -1.0)
    )


def _swung(record: Record, sign: float) -> Record:
    """Return a record whose load moves slowly besides, far more than its noise does."""
    load, noise = record.tau_w_N_m, record.load_noise
    if load is None or noise is None:
        return record
    swing = SWING * slow_noise(np.random.default_rng(load.size + 1), load.size, noise)
    most = MOST_SWING * float(np.std(load))
    swing *= min(1.0, most / max(float(np.std(swing)), 1e-30))
    return record._replace(tau_w_N_m=load + sign * swing)


def _slow_shares(
    still: ClosedLoop,
    theta: Vector,
    nuisances: Sequence[Nuisance],
    quantum_rad: float,
    fast: Sequence[_Rounding],
    mapper: Mapper,
) -> tuple[Slow, ...]:
    """Return what rounding does slowly in each run: a motor that creeps or dwells lingers where the count changes.

    Its angle is then off the counts' mean by up to half a count, for as long as it dwells. Simulated with the counting,
    for loads that differ by what their courses leave open; what all have in common is it, and how they differ where
    the motor dwells is an error.
    """
    counted = [k for k, r in enumerate(still.records) if on_grid(r.channels["theta_m_rad"], quantum_rad)]
    tasks = [(run, load) for run in counted for load in loads_like(still.records[run])]

    def by_counting(task: tuple[int, Vector | None]) -> Vector:
        run, load = task
        alone = still.only(run)
        alone = replace(alone, records=(alone.records[0]._replace(tau_w_N_m=load),))
        with_it, without = (alone.raw(0, theta, nuisances[run], quantum) for quantum in (quantum_rad, 0.0))
        return np.stack((with_it.theta_m_rad - without.theta_m_rad, with_it.theta_j_rad - without.theta_j_rad))

    done = list(zip(tasks, mapper(by_counting, tasks), strict=True))
    found = []
    for run, (record, one) in enumerate(zip(still.records, fast, strict=True)):
        of_run = np.array([each for (which, _), each in done if which == run])
        if not of_run.size:
            none = np.zeros(record.time_s.size)
            found.append(Slow(none, none, np.empty((2, 0, none.size))))
            continue
        mean = np.mean(of_run, axis=0)
        mean[0] -= one.shaken.theta_m_rad - one.plain.theta_m_rad
        mean[1] -= one.shaken.theta_j_rad - one.plain.theta_j_rad
        width = averaged_rows(SLOWEST_SHAKE_HZ, record.period_s)
        errors = _left_open(record, of_run, quantum_rad, still.integral_per_s)
        found.append(Slow(low_pass(mean[0], width), low_pass(mean[1], width), errors))
    return tuple(found)


def _left_open(record: Record, of_run: Vector, quantum_rad: float, integral_per_s: float) -> Vector:
    """Return what dwells leave open of a run; `of_run` (n, 2, rows): what counting does in each simulation."""
    spread = of_run - np.mean(of_run, axis=0)
    spread = low_pass(spread, averaged_rows(FASTEST_HZ, record.period_s)) / np.sqrt(max(spread.shape[0] - 1, 1))
    jaw = white_deviation([record.channels["theta_j_rad"]]) if "theta_j_rad" in record.channels else 0.0
    deviations = (quantum_rad / np.sqrt(12.0), jaw or np.inf)
    return dwell_errors(spread, deviations, record.period_s, integral_per_s)


def averaged_rows(frequency_Hz: float, period_s: float) -> int:
    """Return the rows of moving averages that take out what is faster."""
    return max(3, round(1.0 / (frequency_Hz * period_s)) | 1)


def on_grid(angle: Vector, quantum_rad: float) -> bool:
    """Tell whether angles are whole counts from 0: else it is not known where the count changes."""
    counts = angle / quantum_rad
    return bool(np.max(np.abs(counts - np.rint(counts))) < 0.02)


def loads_like(record: Record) -> list[Vector | None]:
    """Return the load with as much error again as its course leaves open."""
    load, draws = record.tau_w_N_m, record.load_draws
    return [load] if load is None or draws is None else [load + draw for draw in draws]
