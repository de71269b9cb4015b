"""How much a load wanders, by all channels: its own sensor alone takes a smooth load for a rougher one.

A fine encoder sees torques that a load cell doesn't. Where the load's process noise is too large, the filter follows
the encoder's rounding, and through the drive's law that passes for a delay of the current. It is only ever lessened:
what a model doesn't explain would ask for more of it, and hide there.
"""

from collections.abc import Sequence

from hil_forceps.diagnosis.evidence import Mapper, Passes
from hil_forceps.diagnosis.preparation.records import Record
from hil_forceps.diagnosis.state_space.passes import Passed

VARIANCE_FACTOR = 0.5  # of a step
MAX_STEPS = 6  # down to 1/64 of the variance that the load cell alone tells
LEAST_GAIN_CHI2 = 3.84  # of a step, in twice the log likelihood: a parameter gains it by chance in one of 20


def with_likeliest_load_noises(records: Sequence[Record], passes: Passes, mapper: Mapper) -> list[Record]:
    """Return records whose loads wander as is likeliest beside a model; `passes`: of these records with it."""
    pairs = list(zip(records, passes.runs, strict=True))
    return list(mapper(lambda pair: _with_likeliest(pair[0], pair[1], passes), pairs))


def _with_likeliest(record: Record, passed: Passed, passes: Passes) -> Record:
    for _ in range(MAX_STEPS):
        tried = record.with_less_load_noise(VARIANCE_FACTOR)
        if float(tried.series.load_slope_variance.min()) >= float(record.series.load_slope_variance.min()):
            break
        other = tried.passed(passes.theta, passes.plant)
        both = passed.counts & other.counts
        gain = 2.0 * float((other.log_likelihood - passed.log_likelihood)[both].sum())
        if not gain > LEAST_GAIN_CHI2:
            break
        record, passed = tried, other
    return record
