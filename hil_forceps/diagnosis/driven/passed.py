"""Runs that are driven by their motion, beside models, as the search takes them (`evidence.Passed`)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.course import Course
from hil_forceps.diagnosis.driven.rows import DrivenRows
from hil_forceps.diagnosis.driven.simulation import DrivenModel, driven_models
from hil_forceps.diagnosis.driven.whitening import Whitening, white
from hil_forceps.diagnosis.evidence import WILD, Columns, Direction, Mapper, Values, Wave, answers_of, pass_all
from hil_forceps.diagnosis.validation.heldout import DIVERGED_SPANS, Played
from hil_forceps.diagnosis.validation.rows import Rows
from hil_forceps.model.composition import Physics
from hil_forceps.model.driven import Channels

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]

ZERO_SHARE = 0.02  # of the jaw's range: zero of its sensor from run to run
LEAST_ZERO_RAD = 2e-3
OFFSET_SHARE = 0.1  # of the torque or current seen: zero of its sensor from run to run


@dataclass(frozen=True, slots=True, eq=False)
class DrivenRun:
    """A run whose motion drives the model (`evidence.Evidence`)."""

    model: DrivenModel
    zero_sd: dict[str, float]  # of each channel's sensor, from run to run
    white: dict[str, Whitening]
    offset: dict[str, Vector]  # of each channel: what the noise of what drives does

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.rows.name

    @property
    def rows(self) -> Rows:
        """Its rows, as validation takes them."""
        return self.model.rows.rows

    @property
    def load_measured(self) -> bool:
        """Whether it has a load cell."""
        return self.model.rows.theta_j_rad is None

    @property
    def mask(self) -> Mask:
        """Rows that count."""
        return np.asarray(self.rows.weights > 0.0)

    @property
    def jaw_measured(self) -> bool:
        """Whether the jaw's angle is known."""
        return self.model.rows.jaw_rad is not None

    def passed(self, theta: Vector, plant: Physics) -> "DrivenPassed":
        """Return it beside a model."""
        del plant
        rows = self.rows
        shown = self.model.simulated(theta, smoothed=True)
        said = self.model.channels(shown)
        raw = {name: values - said[name] - self.offset[name] for name, values in rows.channels.items()}
        return _passed(self, shown, raw)

    def with_rows_of(self, plant: Physics) -> "DrivenRun":
        """Return the run: none of its channels is moved."""
        del plant
        return self

    def adapted(self, theta: Vector, white: dict[str, Whitening]) -> "DrivenRun":
        """Return the run with other filters, and with what the noise of what drives does beside a model."""
        noisy, plain = (self.model.channels(self.model.simulated(theta, smoothed=how)) for how in (False, True))
        return replace(self, white=white, offset={name: noisy[name] - plain[name] for name in noisy})


@dataclass(frozen=True, slots=True, eq=False)
class DrivenPassed:
    """It beside a model; a zero of each channel is fitted to what is left, and everything else beside that."""

    run: DrivenRun
    shown: Channels
    raw: dict[str, Vector]  # residuals of the channels
    zeros: dict[str, float]
    counts: Mask  # n × channels
    whitened: Matrix  # n × channels
    projections: tuple[tuple[Vector, float], ...]  # of each channel: the zero's weighted column, and its variance

    @property
    def load_measured(self) -> bool:
        """Whether the run has a load cell."""
        return self.run.load_measured

    @property
    def block_rows(self) -> int:
        """One row: what hangs together is whitened (`whitening.py`)."""
        return 1

    @property
    def residual(self) -> Matrix:
        """Whitened residuals, 0 where they don't count."""
        return np.where(self.counts, self.whitened, 0.0)

    @property
    def influence(self) -> Matrix:
        """1 where a row counts: what a model lacks shows where a motion turns, in rows that are rare and large."""
        return self.counts.astype(np.float64)

    @property
    def log_likelihood(self) -> Matrix:
        """Log likelihood; the first row that counts has that of the zeros, too."""
        found = -0.5 * self.whitened**2
        for place, name in enumerate(self.raw):
            row = int(np.argmax(self.counts[:, place]))
            found[row, place] -= 0.5 * (self.zeros[name] / self.run.zero_sd[name]) ** 2
        return np.asarray(found)

    def as_recorded(self, values: Values) -> Values:
        """Return values as they are: no channel is moved."""
        return values

    def course(self, base: Physics, *, before: bool) -> Course:
        """Return what happened in the run; nothing of it hangs on what is compared."""
        del base, before
        return self.run.model.course(self.shown)

    def answers(self, base: Physics, directions: Sequence[Direction], waves: Sequence[Wave] = ()) -> Columns:
        """Return how the residuals answer to directions and behind them to waves (n·channels × columns)."""
        model, found = self.run.model, self.changes(base, directions)
        course = self.course(base, before=False)
        for wave in waves:
            phase = wave.harmonic * course.theta_m
            torque = wave.amplitude * (np.cos(phase) if wave.cosine else np.sin(phase))
            if wave.with_current:  # a sensor of torque shows it as any other
                torque = torque * base.K_t * course.current_A * ("current_A" in self.raw)
            found.append(model.static_answer(base, "motor", torque))
        return self.columns(found)

    def curves(self, base: Physics, columns: Sequence[tuple[str, Vector]]) -> Columns:
        """Return how they answer to courses of a torque, a wire's force, an error of a sensor."""
        return self.columns([self.run.model.static_answer(base, *column) for column in columns])

    def with_filters(self, white: dict[str, Whitening]) -> "DrivenPassed":
        """Return the same with other filters."""
        return _passed(replace(self.run, white=white), self.shown, self.raw)

    def changes(self, base: Physics, directions: Sequence[Direction]) -> list[dict[str, Vector]]:
        """Return the changes of what is predicted in some directions."""
        model, said = self.run.model, self.run.model.channels(self.shown)

        def shown(theta: Vector, _: float) -> dict[str, Vector]:
            return model.channels(model.simulated(theta, smoothed=True))

        return [
            {name: direction.per * (there[name] - (own or said)[name]) for name in said}
            for direction, (there, own) in zip(directions, answers_of(base, directions, shown), strict=True)
        ]

    def columns(self, changes: Sequence[dict[str, Vector]]) -> Columns:
        """Return the answers of the residuals to changes of what is predicted."""
        n = self.counts.shape[0]
        found = np.zeros((n, len(self.raw), len(changes)), dtype=np.float32)
        for place, name in enumerate(self.raw):
            change = np.column_stack([c.get(name, np.zeros(n)) for c in changes])
            with np.errstate(over="ignore", invalid="ignore"):
                white = -self.run.white[name].of(change, self.run.mask)
                wild = ~np.isfinite(white).all(axis=0) | (np.abs(white).max(axis=0) > WILD)
            white[:, wild] = 0.0
            column, variance = self.projections[place]
            found[:, place] = white - variance * np.outer(column, column @ white)
        return found.reshape(n * len(self.raw), -1)


def _passed(run: DrivenRun, shown: Channels, raw: dict[str, Vector]) -> DrivenPassed:
    mask = run.mask
    zeros, whitened, projections = {}, [], []
    for name, values in raw.items():
        white, sd = run.white[name], run.zero_sd[name]
        column, left = white.of(np.column_stack((np.ones(values.size), values)), mask).T
        variance = 1.0 / (float(column @ column) + 1.0 / sd**2)
        zero = variance * float(column @ left)
        zeros[name] = zero
        whitened.append(left - zero * column)
        projections.append((column, variance))
    counts = np.repeat(mask[:, np.newaxis], len(raw), axis=1)
    finite = [np.isfinite(w).all() for w in whitened]
    stacked = np.column_stack([w if good else np.full(w.size, WILD) for w, good in zip(whitened, finite, strict=True)])
    return DrivenPassed(run, shown, raw, zeros, counts, stacked, tuple(projections))


def driven_runs(rows: Sequence[DrivenRows]) -> list[DrivenRun]:
    """Return runs as the search takes them; what they leave is taken for white until a model has been fitted."""
    seen = max(float(np.sqrt(np.mean(run.rows.channels[run.torque_channel] ** 2))) for run in rows)
    angles = [run.rows.channels["theta_j_rad"] for run in rows if "theta_j_rad" in run.rows.channels]
    zero = max([LEAST_ZERO_RAD, *(ZERO_SHARE * float(np.ptp(angle)) for angle in angles)])
    zeros = {"theta_j_rad": zero, "current_A": OFFSET_SHARE * seen, "tau_m_N_m": OFFSET_SHARE * seen}
    found = []
    for model in driven_models(rows):
        channels = model.rows.rows.channels
        first = {name: white(max(model.rows.noise[name], 1e-3 * float(np.ptp(v)))) for name, v in channels.items()}
        nothing = {name: np.zeros(values.size) for name, values in channels.items()}
        found.append(DrivenRun(model, {name: zeros[name] for name in channels}, first, nothing))
    return found


def play(runs: Sequence[DrivenRun], theta: Vector, mapper: Mapper) -> Played:
    """Simulate runs with a vector of parameters."""
    adapted = list(mapper(lambda run: run.adapted(theta, run.white), runs))
    passes = pass_all(adapted, theta, mapper)
    courses = [passed.course(passes.plant, before=False) for passed in passes.runs]
    return Played([_channels(passed) for passed in passes.runs], courses)


def _channels(passed: DrivenPassed) -> dict[str, Vector]:
    rows = passed.run.rows
    said = {name: values - passed.raw[name] + passed.zeros[name] for name, values in rows.channels.items()}
    span = {name: max(float(np.ptp(values)), 1e-12) for name, values in rows.channels.items()}
    kept = {
        name: np.nan_to_num(said[name], nan=DIVERGED_SPANS * span[name], posinf=DIVERGED_SPANS * span[name])
        for name in said
    }
    return {"theta_m_rad": rows.reference_rad, **kept}
