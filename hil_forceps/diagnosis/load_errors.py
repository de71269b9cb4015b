"""What errors of the load do to the channels of a simulation that it drives.

The load cell's noise moves the simulated motor and jaw and not the real ones, at each instant as much as the load's
course lets through (`load_course.py`). Below some 40 Hz that is nearly all the noise there is, and it comes in bursts,
where the load bends. In the Fourier domain it is correlated over frequencies and channels, but of low rank: with errors
G of a run and all other noise white, the covariance is I + G Gᵀ (`low_rank.py`), as in generalised least squares.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.linear import Response
from hil_forceps.diagnosis.low_rank import LEAST_POWER, LoadErrors
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.spectrum import Layout, Part, spectrum_of

Vector = NDArray[np.float64]
Matrix = NDArray[np.float32]

LEAST_SHOWN = 10.0 * LEAST_POWER  # of the sensors' noise along a column


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

    return layout._replace(load=tuple(mapper(of_run, range(len(records)))))


def _of_run(parts: Sequence[Part], record: Record, response: Response, sensors: Vector) -> LoadErrors:
    error = record.load_error
    assert error is not None
    spectra = fft.rfft(np.ascontiguousarray(error.T))
    entries, columns = [np.empty(0, dtype=np.intp)], [np.empty((0, error.shape[1]), dtype=np.float32)]
    for part in parts:
        gain = response.gains["jaw"].get(part.channel)
        if gain is None:
            continue
        seen = spectrum_of(part, fft.irfft(spectra * gain.astype(np.complex64), part.rows))
        power = np.einsum("ij,ij->j", seen.real, seen.real) + np.einsum("ij,ij->j", seen.imag, seen.imag)
        reached = np.flatnonzero(power > LEAST_POWER * sensors[part.start : part.stop : 2])
        bins = int(reached[-1]) + 1 if reached.size else 0
        entries.append(part.start + np.arange(2 * bins))
        columns.append(np.ascontiguousarray(seen[:, :bins]).view(np.float32).T)
    return _shorter(LoadErrors(np.concatenate(entries), np.concatenate(columns)), sensors)


def _shorter(errors: LoadErrors, sensors: Vector) -> LoadErrors:
    """Return the same errors in fewer columns: what no sensor would ever show is left out."""
    seen = errors.columns / np.sqrt(sensors[errors.entries])[:, None].astype(np.float32)
    values, vectors = np.linalg.eigh((seen.T @ seen).astype(np.float64))
    kept = values > LEAST_SHOWN
    return LoadErrors(errors.entries, np.asarray(errors.columns @ vectors[:, kept], dtype=np.float32))
