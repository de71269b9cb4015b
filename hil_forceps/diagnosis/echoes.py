"""What the load cell's noise does to a simulation that it drives, as it happens: drawn anew and smoothed like the load.

Whitening takes that noise to be spread evenly over a run. But smoothing lets it through where the load bends, and takes
it out elsewhere: between 10 and 70 Hz a tenth of the time holds up to four fifths of its power. At the same instants
something happens, so there the columns of friction, drift and ripple live, and chance gives them several times what it
gives to others. The residual alone can't tell such bursts from effects.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.predict import ClosedLoop
from hil_forceps.diagnosis.problem import Matrix, Problem
from hil_forceps.diagnosis.smoothing import drawn_noise, smooth_load
from hil_forceps.diagnosis.spectrum import Flat, transform

Vector = NDArray[np.float64]

ECHOES = 16


def load_echoes(problem: Problem, u: Vector) -> Matrix | None:
    """Return what each draw of the load's noise changes in the channels (entries, draws), not whitened.

    None where the drive's law or the noise isn't known.
    """
    loop = problem.simulate_runs
    if not isinstance(loop, ClosedLoop) or any(r.load_noise is None for r in loop.records):
        return None
    theta, nuisances = problem.theta(u), problem.nuisances(u)
    own = replace(loop, offset=(), stand_ins=())

    def seen(loop: ClosedLoop) -> Flat:
        runs = range(len(nuisances))
        return transform(problem.layout, [loop.outputs(k, loop.raw(k, theta, nuisances[k])) for k in runs])

    before = seen(own)

    def echo(number: int) -> Flat:
        records = tuple(_with_noise_anew(r, np.random.default_rng([number, k])) for k, r in enumerate(own.records))
        return seen(replace(own, records=records)) - before

    return np.stack(list(problem.mapper(echo, range(ECHOES))), axis=1)


def _with_noise_anew(record: Record, rng: np.random.Generator) -> Record:
    """Return a record whose load holds as much noise again as its own smoothing leaves."""
    load, noise = record.tau_w_N_m, record.load_noise
    assert load is not None
    assert noise is not None
    noisy = load + drawn_noise(rng, load.size, record.period_s, noise)
    smooth = smooth_load(noisy, record.edge_rows, record.period_s, noise, record.most_bent)
    return record._replace(tau_w_N_m=smooth)
