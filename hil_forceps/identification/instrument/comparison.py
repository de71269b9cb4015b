"""The transmission estimator beside the paper's algorithm, the plain model and black boxes, on runs held out.

Everything is fitted to the training runs of a split: the transmission model, the black boxes, and for the estimators of
the bench the ratio, K_t and their zeros. One fit of the transmission model serves both parts; a black box is fitted to
the part that it is scored on. Black boxes get the same causal low-passed inputs: θ_m, its speed, what drives.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.estimation import transmission
from hil_forceps.identification.instrument.black_boxes import SEED, Fit, Predict, black_boxes
from hil_forceps.identification.instrument.held_out_errors import HeldOut, HeldOutErrors, rms
from hil_forceps.identification.instrument.report import CLOSING, WHOLE, Array, RunInfo
from hil_forceps.identification.instrument.score import Estimated, parts_of
from hil_forceps.identification.instrument.series_zeros import SeriesZeros
from hil_forceps.identification.instrument.splits import Split, splits
from hil_forceps.identification.instrument.transmission_fit import TransmissionFit, counted, fit_transmission, inputs

EXTENDED = "transmission"
PUBLISHED_PROTOCOL = "closing strokes, random samples"
TRAINED_SHARE = 0.85  # the publication's 70 % and the 15 % that it stopped by; what is left is scored

Bench = Callable[[Sequence[Run], Run, str], dict[str, Estimated]]  # training runs, run, source -> by method
Note = Callable[[str], None]


class Residual(NamedTuple):
    """What the transmission estimator leaves on one held-out run and part: mean, and rest about the mean."""

    split: str
    run: str
    source: str
    part: str
    tau_w_mean_N_m: float
    tau_w_rest_N_m: float
    theta_j_mean_rad: float
    theta_j_rest_rad: float


class Course(NamedTuple):
    """One held-out run to draw, arrays [samples]."""

    split: str
    run: RunInfo
    source: str
    time_s: Array
    tau_w_measured_N_m: Array
    theta_j_measured_rad: Array
    estimated: Estimated


class Comparison(NamedTuple):
    """Everything the comparison found."""

    splits: tuple[Split, ...]
    fits: Mapping[str, TransmissionFit]  # "split/source"
    overall: tuple[HeldOut, ...]
    by_series: tuple[HeldOut, ...]  # the same with the zero of each series by its training runs
    zeros: Mapping[str, SeriesZeros]  # "split/source/part", of the transmission estimator
    per_run: tuple[HeldOut, ...]
    residuals: tuple[Residual, ...]
    courses: tuple[Course, ...]


def compare(
    runs: Sequence[Run],
    infos: Sequence[RunInfo],
    sources: Sequence[str],
    bench: Bench,
    *,
    with_learned: bool,
    note: Note | None = None,
) -> Comparison:
    """Score everything on every split that the runs allow; UserError as in `black_boxes` and `fit_transmission`."""
    boxes = black_boxes(with_learned=with_learned)
    found = splits(infos)
    named, known = {run.name: run for run in runs}, {info.name: info for info in infos}
    fits: dict[str, TransmissionFit] = {}
    overall: list[HeldOut] = []
    by_series: list[HeldOut] = []
    zeros: dict[str, SeriesZeros] = {}
    per_run: list[HeldOut] = []
    residuals: list[Residual] = []
    courses: list[Course] = []
    for split in found:
        errors = HeldOutErrors(split)
        train, held = [named[name] for name in split.train], [named[name] for name in split.held_out]
        for source in sources:
            _tell(note, f"{split.name}, {source}")
            fit = fit_transmission(train, split.levels, source)
            fits[f"{split.name}/{source}"] = fit
            for run in train:
                _learn(errors, run, source, EXTENDED, estimate(fit, run))
            for run in held:
                estimated = estimate(fit, run)
                residuals += _score(errors, run, source, EXTENDED, estimated)
                if run.name in _drawn(held, known):
                    courses.append(_course(split, known[run.name], run, source, estimated))
            _score_bench(errors, train, held, source, bench)
            for method, box in boxes.items():
                _tell(note, f"{split.name}, {source}, {method}")
                _score_box(errors, train, held, fit, method, box)
        overall += errors.overall()
        by_series += errors.by_series()
        zeros |= errors.zeros_of(EXTENDED)
        per_run += errors.per_run
    for source in sources:
        _tell(note, f"{PUBLISHED_PROTOCOL}, {source}")
        overall += _published_protocol(runs, found, source, boxes)
    return Comparison(
        found, fits, tuple(overall), tuple(by_series), zeros, tuple(per_run), tuple(residuals), tuple(courses)
    )


def estimate(fit: TransmissionFit, run: Run) -> Estimated:
    """Send a run through the fitted estimator, sample by sample."""
    return Estimated(*transmission.run(fit.constants, *inputs(run, fit.source)))


def _score(errors: HeldOutErrors, run: Run, source: str, method: str, estimated: Estimated) -> list[Residual]:
    tau_w = estimated.tau_w_N_m - run.columns["tau_w_N_m"]
    theta_j = estimated.theta_j_rad - run.columns["theta_j_rad"]
    residuals = []
    for part, rows in parts_of(run).items():
        a, b = tau_w[rows], theta_j[rows]
        errors.add(run.name, source, method, part, a, b)
        if len(a):
            moments = float(np.mean(a)), float(np.std(a)), float(np.mean(b)), float(np.std(b))
            residuals.append(Residual(errors.split, run.name, source, part, *moments))
    return residuals


def _learn(errors: HeldOutErrors, run: Run, source: str, method: str, estimated: Estimated) -> None:
    """Take in the mean errors on a training run."""
    for part, rows in parts_of(run).items():
        if np.any(rows):
            tau_w, theta_j = _differences(run, estimated, rows)
            errors.add_training(run.name, source, method, part, -float(np.mean(tau_w)), -float(np.mean(theta_j)))


def _score_bench(errors: HeldOutErrors, train: Sequence[Run], held: Sequence[Run], source: str, bench: Bench) -> None:
    """Score the bench's estimators with zeros, per part, from the training runs."""
    trained = [wrong for wrong in _wrong(train, train, source, bench) if len(wrong.tau_w)]
    sums: dict[tuple[str, str], list[tuple[float, float, int]]] = {}
    for _, method, part, tau_w, theta_j in trained:
        own = float(np.sum(tau_w)), float(np.sum(theta_j)), len(tau_w)
        sums.setdefault((method, part), []).append(own)
    zeros = {key: _zeros(of_runs) for key, of_runs in sums.items()}
    for run, method, part, tau_w, theta_j in trained:
        tau_zero, theta_zero = zeros[method, part]
        means = float(np.mean(tau_w)) - tau_zero, float(np.mean(theta_j)) - theta_zero
        errors.add_training(run, source, method, part, *means)
    for run, method, part, tau_w, theta_j in _wrong(train, held, source, bench):
        if (method, part) in zeros and np.all(np.isfinite(tau_w)):
            tau_zero, theta_zero = zeros[method, part]
            errors.add(run, source, method, part, tau_w - tau_zero, theta_j - theta_zero)


class _Wrong(NamedTuple):
    """Measured minus estimated over a part of a run."""

    run: str
    method: str
    part: str
    tau_w: Array
    theta_j: Array


def _wrong(train: Sequence[Run], runs: Sequence[Run], source: str, bench: Bench) -> Iterator[_Wrong]:
    for run in runs:
        for method, estimated in bench(train, run, source).items():
            for part, rows in parts_of(run).items():
                yield _Wrong(run.name, method, part, *_differences(run, estimated, rows))


def _zeros(of_runs: Sequence[tuple[float, float, int]]) -> tuple[float, float]:
    """Return the mean errors of torque and angle over all samples."""
    tau_w, theta_j, count = map(sum, zip(*of_runs, strict=True))
    return tau_w / count, theta_j / count


def _differences(run: Run, estimated: Estimated, rows: NDArray[np.bool_]) -> tuple[Array, Array]:
    return (
        run.columns["tau_w_N_m"][rows] - estimated.tau_w_N_m[rows],
        run.columns["theta_j_rad"][rows] - estimated.theta_j_rad[rows],
    )


def _score_box(
    errors: HeldOutErrors, train: Sequence[Run], held: Sequence[Run], fit: TransmissionFit, method: str, box: Fit
) -> None:
    for part in (WHOLE, CLOSING):
        x, y = _stacked(train, fit, part)
        if not len(x):
            continue
        predict: Predict = box(x, y)

        def wrong_on(run: Run, rows: NDArray[np.intp], predict: Predict = predict) -> Array:
            return predict(momentary(fit, run)[rows]) - _targets(run)[rows]

        for run in train:
            rows = np.intersect1d(counted(run), np.flatnonzero(parts_of(run)[part]))
            if len(rows):
                tau_w_mean, theta_j_mean = np.mean(wrong_on(run, rows), axis=0)
                errors.add_training(run.name, fit.source, method, part, float(tau_w_mean), float(theta_j_mean))
        for run in held:
            rows = np.flatnonzero(parts_of(run)[part])
            if len(rows):
                errors.add(run.name, fit.source, method, part, *wrong_on(run, rows).T)


def momentary(fit: TransmissionFit, run: Run) -> Array:
    """Return what a black box gets [samples, 3]: θ_m, its speed and what drives, low-passed as in the estimator."""
    time_ns, theta, _, drive = inputs(run, fit.source)
    rows, free = transmission.terms(fit.constants, time_ns, theta, theta, drive)
    at_drive, at_speed = transmission.TERM_DRIVE, transmission.TERM_SPEED
    return np.column_stack([free, rows[:, at_speed], rows[:, at_drive]])


def _stacked(runs: Sequence[Run], fit: TransmissionFit, part: str) -> tuple[Array, Array]:
    x, y = [], []
    for run in runs:
        rows = np.intersect1d(counted(run), np.flatnonzero(parts_of(run)[part]))
        x.append(momentary(fit, run)[rows])
        y.append(_targets(run)[rows])
    return np.concatenate(x), np.concatenate(y)


def _targets(run: Run) -> Array:
    return np.column_stack([run.columns["tau_w_N_m"], run.columns["theta_j_rad"]])


def _published_protocol(
    runs: Sequence[Run], found: Sequence[Split], source: str, boxes: Mapping[str, Fit]
) -> list[HeldOut]:
    """Score on closing strokes with samples split at random, so that neighbours of every scored one were fitted to.

    The transmission model is fitted to whole runs; here it has seen them all, as the publication's network has.
    """
    if not found:
        return []
    fit = fit_transmission(runs, found[0].levels, source)
    x, y = _stacked(runs, fit, CLOSING)
    trained = np.random.default_rng(SEED).random(len(x)) < TRAINED_SHARE
    scores = []
    for method, box in boxes.items():
        wrong = box(x[trained], y[trained])(x[~trained]) - y[~trained]
        scores.append(_random_score(source, method, wrong))
    ours = []
    for run in runs:
        rows = np.intersect1d(counted(run), np.flatnonzero(parts_of(run)[CLOSING]))
        ours.append(np.column_stack(estimate(fit, run))[rows])
    return [_random_score(source, EXTENDED, (np.concatenate(ours) - y)[~trained]), *scores]


def _random_score(source: str, method: str, wrong: Array) -> HeldOut:
    return HeldOut(PUBLISHED_PROTOCOL, "", source, method, CLOSING, rms(wrong[:, 0]), rms(wrong[:, 1]), len(wrong))


def _drawn(held: Sequence[Run], known: Mapping[str, RunInfo]) -> set[str]:
    """Choose three held-out runs to draw: those of lowest, middle and highest load."""
    ordered = sorted(held, key=lambda run: known[run.name].load_N_m)
    return {ordered[at].name for at in (0, len(ordered) // 2, len(ordered) - 1)}


def _course(split: Split, info: RunInfo, run: Run, source: str, estimated: Estimated) -> Course:
    columns = run.columns
    return Course(split.name, info, source, columns["time_s"], columns["tau_w_N_m"], columns["theta_j_rad"], estimated)


def _tell(note: Note | None, what: str) -> None:
    if note:
        note(what)
