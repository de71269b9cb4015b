"""What errors of the load do to the channels of a simulation that it drives.

The load cell's noise moves the simulated motor and jaw and not the real ones, at each instant as much as the load's
course lets through (`load_course.py`). Below some 40 Hz that is nearly all the noise there is, and it comes in bursts,
where the load bends. In the Fourier domain it is correlated over frequencies and channels, but of low rank: with errors
G of a run and all other noise white, the covariance is I + G Gᵀ (`low_rank.py`), as in generalised least squares.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.linear import Response
from hil_forceps.diagnosis.low_rank import LEAST_POWER, LoadErrors
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.spectrum import Layout, Part, fill, spectrum_of

Vector = NDArray[np.float64]
Matrix = NDArray[np.float32]
Spectra = NDArray[np.complexfloating]

SPREAD = 40  # bins by which weights spread a spectrum


def with_load_errors(
    layout: Layout, records: Sequence[Record], responses: Sequence[Response], sensors: Vector, mapper: Mapper = map
) -> Layout:
    """Return the layout with what the load's errors do; as it is where they aren't known.

    `responses`: of each run, of a plant near the true one. `sensors`: power of the sensors' own noise in each band.
    """
    if any(record.load_error is None for record in records):
        return layout._replace(load=())
    power = sensors[layout.band_of]
    parts = [[part for part in layout.parts if part.run == run] for run in range(len(records))]

    def of_run(run: int) -> LoadErrors:
        return _of_run(parts[run], records[run], responses[run], power)

    return layout._replace(load=tuple(mapper(of_run, range(len(records)))), dwells=())


def with_dwells(layout: Layout, errors: Sequence[Mapping[str, Vector]]) -> Layout:
    """Return the layout with other errors of each run's channels (k, rows), in the entries that the load's reach."""
    if not layout.load:
        return layout

    def of_run(run: int) -> Matrix:
        count = max(rows.shape[0] for rows in errors[run].values())
        seen = np.zeros((count, layout.size), dtype=np.float32)
        for part in layout.parts:
            if part.run == run and part.channel in errors[run]:
                fill(seen, part, errors[run][part.channel])
        return np.ascontiguousarray(seen[:, layout.load[run].entries].T)

    return layout._replace(dwells=tuple(of_run(run) for run in range(len(layout.load))))


def _of_run(parts: Sequence[Part], record: Record, response: Response, sensors: Vector) -> LoadErrors:
    error = record.load_error
    assert error is not None
    spectra = fft.rfft(np.ascontiguousarray(error.T))
    entries, columns = [np.empty(0, dtype=np.intp)], [np.empty((0, error.shape[1]), dtype=np.float32)]
    for part in parts:
        gain = response.gains["jaw"].get(part.channel)
        if gain is None:
            continue
        seen = _seen(part, spectra, gain.astype(np.complex64), LEAST_POWER * sensors[part.start : part.stop : 2])
        entries.append(part.start + np.arange(2 * seen.shape[1]))
        columns.append(np.ascontiguousarray(seen).view(np.float32).T)
    return LoadErrors(np.concatenate(entries), np.concatenate(columns))


def _seen(part: Part, spectra: Spectra, gain: Spectra, least: Vector) -> Spectra:
    """Return the scaled spectrum of each error in a channel, up to the last bin where all together reach `least`.

    On every second or fourth row where nothing is left that these would not show.
    """
    answers = spectra * gain
    last = _reached(part.scale**2 * _power(answers), least) + SPREAD
    every = next(n for n in (4, 2, 1) if n == 1 or (part.rows % (2 * n) == 0 and last < part.rows // (2 * n)))
    fewer = part._replace(rows=part.rows // every, weights=part.weights[::every])
    seen = spectrum_of(fewer, fft.irfft(answers[:, : fewer.rows // 2 + 1], fewer.rows))
    return np.asarray(seen[:, : _reached(_power(seen), least[: seen.shape[1]])])


def _reached(power: Vector, least: Vector) -> int:
    """Return how many bins there are up to the last one of more than the least power."""
    reached = np.flatnonzero(power > least)
    return int(reached[-1]) + 1 if reached.size else 0


def _power(spectra: Spectra) -> Vector:
    """Return the power of all rows together in each bin."""
    return np.asarray(np.sum(spectra.real**2 + spectra.imag**2, axis=0))
