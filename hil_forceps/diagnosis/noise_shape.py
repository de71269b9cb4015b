"""How noise is spread within each band: what the load cell's noise does to a simulation that it drives.

Smoothing leaves the slow part of that noise in the load. It moves the simulated motor and the simulated jaw and not the
real ones, both in a known way, and no more above some Hz: within the lowest band of short runs the noise falls to a
third. Were it taken as flat there, the lowest bins would pass for surer than they are, and chance would find slow
curves and slow effects in them.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.linear import Response
from hil_forceps.diagnosis.spectrum import JAW, MOTOR, Layout, Part, pairs

Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]

LEAST = 0.1  # of a band's mean: what tapering lets in from other bins is never less
TELLING = 0.2  # mean coherence of a band: below it the jaw follows the motor by something else than the load's noise


def shaped(layout: Layout, records: Sequence[Record], responses: Sequence[Response], sensors: Vector) -> Layout:
    """Return the layout with the noise's shape within its bands; as it is where the load's noise isn't known.

    `responses`: of each run, of a plant near the true one. `sensors`: power of the sensors' own noise in each band.
    """
    if any(record.load_noise_left is None for record in records):
        return layout
    power = sensors[layout.band_of]
    follows: list[Complex] = []
    for part in layout.parts:
        if part.channel in responses[part.run].gains["jaw"]:
            power[part.start : part.stop] += np.repeat(_of_load(part, records, responses), 2)
    for motor, jaw in pairs(layout):
        own = sensors[layout.band_of[motor.start : motor.stop : 2]]
        # How much of the motor's noise is the load's: so much of the jaw's follows it and is taken out.
        seen = 1.0 - own / power[motor.start : motor.stop : 2]
        of_load, band = _of_load(jaw, records, responses), layout.band_of[jaw.start : jaw.stop : 2]
        power[jaw.start : jaw.stop] -= np.repeat(of_load * seen, 2)
        gains = responses[motor.run].gains["jaw"]
        ratio = gains[JAW] * gains[MOTOR].conj() / np.maximum(np.abs(gains[MOTOR]) ** 2, 1e-300)
        coherence = of_load * seen / (of_load + sensors[band])
        follows.append(np.where(_mean(coherence, band) > TELLING, ratio * seen, 1.0))
    power = np.maximum(power, LEAST * _mean(power, layout.band_of))
    power /= _mean(power, layout.band_of)
    bins = np.concatenate(follows).astype(np.complex64) if follows else None
    return layout._replace(shape=power.astype(np.float32), follows=bins)


def _of_load(part: Part, records: Sequence[Record], responses: Sequence[Response]) -> Vector:
    """Return the power that the load's noise, as smoothing leaves it, has in each bin of a part."""
    record = records[part.run]
    noise = record.load_noise_left
    assert noise is not None
    frequency = np.arange((part.stop - part.start) // 2) / (part.rows * record.period_s)
    left = np.interp(frequency, noise.frequency_Hz, noise.power)
    return np.asarray(np.abs(responses[part.run].gains["jaw"][part.channel]) ** 2 * left)


def _mean(values: Vector, band: NDArray[np.intp]) -> Vector:
    """Return for each entry the mean of its band."""
    count = np.bincount(band)
    return np.asarray((np.bincount(band, weights=values) / np.maximum(count, 1))[band])
