"""Measured runs of an instrument through the estimators: jaw torque and jaw angle from the motor side alone.

What is measured at the jaw is compared with what the bench's estimators make of spindle angle and spindle torque (or
motor current). Fitted are, once per data set: the ratio r_m/r_j where the rig leaves r_m unknown, K_t where the rig
leaves it unknown, and the zeros of jaw torque and jaw angle. K_t relates two motor-side sensors and is fitted to them,
never to the jaw. Friction, stiffness and inertias are the rig's.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from hil_forceps.data.readers.read_run import FORMATS, read_run
from hil_forceps.data.readers.surgical_tool.reader import iter_surgical_tool
from hil_forceps.data.readers.tables.mapping import ColumnMap
from hil_forceps.data.readers.tables.packed import inner_name
from hil_forceps.data.run import Run
from hil_forceps.estimation import batch
from hil_forceps.estimation.registry import ESTIMATOR_IDS, make_estimator
from hil_forceps.identification.instrument.comparison import Comparison, compare
from hil_forceps.identification.instrument.report import (
    WHOLE,
    Array,
    Fitted,
    InstrumentReport,
    RunInfo,
    SAME_FREQUENCY_Hz,
    Trace,
    write_report,
)
from hil_forceps.identification.instrument.score import DROPPED_S, Estimated, Key, Tally, Zeros, parts_of
from hil_forceps.rig import Rig, UserError
from hil_forceps.rig.plant import PlantParameters

Progress = Callable[[int, int, str], None]  # done, of (0: not known), what

CONSTANT = "constant"  # the trivial predictor: the mean of what was measured
COMPARED = ("improved", "kalman")  # the paper's own and the plain model's best, beside the transmission estimator
RIGID = "rigid"  # the wire does not stretch, nothing rubs and nothing has inertia
SOURCES = ("tau_m_N_m", "current_A")
MIN_DURATION_S = 2 * DROPPED_S + 1.0
_TABLES = frozenset(suffix for each in FORMATS if each.is_table for suffix in each.suffixes)
DRAWN_RUNS = 3


class _Plan(NamedTuple):
    """The rig with its gaps filled, and from what."""

    rig: Rig
    plant: PlantParameters
    ratio_from: str
    torque_constant_from: str


def replay_instrument(
    path: str | Path, rig: Rig, out: str | Path, progress: Progress | None = None
) -> InstrumentReport:
    """Run what is at `path` (surgical-tool folder or zip, or one CSV) through every estimator; write what came out.

    Writes `instrument.json` and `instrument_runs.csv` into `out`; `hil_forceps.report.identification.instrument` draws
    the report that is returned. UserError when runs can't be read or lack what was measured at the jaw, or when the rig
    leaves something unknown that can't be fitted; OSError as the disk raises it.
    """
    report = evaluate(Path(path).stem, read_instrument(path, progress), rig, progress)
    write_report(report, Path(out))
    return report


def read_instrument(
    path: str | Path, progress: Progress | None = None, mapping: ColumnMap = MappingProxyType({})
) -> list[Run]:
    """Read the runs of a surgical-tool folder or zip, or one table; UserError when they can't be used here."""
    runs: list[Run] = []
    for run in _read(Path(path), mapping):
        _check(run)
        runs.append(run)
        _tell(progress, len(runs), 0, f"read run {run.name}")
    return runs


def compare_instrument(
    runs: Sequence[Run], rig: Rig, *, with_learned: bool = False, progress: Progress | None = None
) -> Comparison:
    """Fit the transmission estimator and what it is compared with to training runs, score them on those held out.

    `with_learned` adds what needs scikit-learn. Errors as in `replay_instrument` and `compare`.
    """
    plans: dict[tuple[str, ...], _Plan] = {}

    def bench(train: Sequence[Run], run: Run, source: str) -> dict[str, Estimated]:
        key = tuple(each.name for each in train)
        if key not in plans:
            plans[key] = _fill_gaps(rig, train)
        return _estimates(run, _motor_torque(run, source, plans[key]), plans[key], COMPARED)

    sources = [source for source in SOURCES if all(source in run.columns for run in runs)]
    return compare(
        runs,
        [_describe(run) for run in runs],
        sources,
        bench,
        with_learned=with_learned,
        note=None if progress is None else lambda what: progress(0, 0, what),
    )


def evaluate(name: str, runs: Sequence[Run], rig: Rig, progress: Progress | None = None) -> InstrumentReport:
    """Score every estimator on `runs`, one data set with shared zeros; errors as in `replay_instrument`."""
    for run in runs:
        _check(run)
    plan = _fill_gaps(rig, runs)
    infos = tuple(_describe(run) for run in runs)
    drawn = _spread(infos)
    tally = Tally()
    traces: list[Trace] = []
    for done, (run, info) in enumerate(zip(runs, infos, strict=True), start=1):
        parts = parts_of(run)
        nothing = np.zeros(len(run))
        tally.add(run, parts, "", CONSTANT, Estimated(nothing, nothing))
        for source in _sources(run):
            torque = _motor_torque(run, source, plan)
            estimated = _estimates(run, torque, plan)
            for method, values in estimated.items():
                tally.add(run, parts, source, method, values)
            if info.name in drawn and source == _sources(run)[0]:
                traces.append(_trace(run, info, source, torque, estimated))
        _tell(progress, done, len(runs), f"run {run.name}")
    zeros = tally.zeros()
    return InstrumentReport(
        name=name,
        runs=infos,
        fitted=_fitted(plan, zeros),
        overall=tally.overall(),
        per_run=tally.per_run(),
        traces=tuple(_at_zero(trace, zeros) for trace in traces),
        assumed=_assumed(plan),
    )


def _read(path: Path, mapping: ColumnMap) -> Iterator[Run]:
    if Path(inner_name(path)).suffix.lower() in _TABLES:
        yield from read_run(path, mapping=mapping)
    else:
        yield from iter_surgical_tool(path)


def _check(run: Run) -> None:
    missing = [name for name in ("theta_j_rad", "tau_w_N_m") if name not in run.columns]
    if missing:
        raise UserError(
            f"run {run.name}: {missing[0]} was not measured, but estimates are compared with it; use runs that have it"
        )
    seconds = float(run.columns["time_s"][-1] - run.columns["time_s"][0])
    if seconds < MIN_DURATION_S:
        raise UserError(
            f"run {run.name}: lasts {seconds:.3g} s, but at least {MIN_DURATION_S:g} s are needed; leave it out"
        )


def _sources(run: Run) -> list[str]:
    return [source for source in SOURCES if source in run.columns]


def _motor_torque(run: Run, source: str, plan: _Plan) -> Array:
    return run.columns[source] * (plan.plant.torque_constant_N_m_per_A if source == "current_A" else 1.0)


def _estimates(
    run: Run, motor_torque_N_m: Array, plan: _Plan, methods: Sequence[str] = ESTIMATOR_IDS
) -> dict[str, Estimated]:
    plant = plan.plant
    ratio = plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    theta_m_rad = run.columns["theta_m_rad"]
    estimated = {RIGID: Estimated(motor_torque_N_m / ratio, ratio * theta_m_rad)}
    sample_time_s = round(run.sample_time_s, 9)
    for method in methods:
        estimator = make_estimator(method, plan.rig, sample_time_s, over_wire=False)
        tau_w, elongation_m = batch.run(estimator, run.time_ns, theta_m_rad, motor_torque_N_m)
        # (3) solved for the jaw
        estimated[method] = Estimated(tau_w, ratio * theta_m_rad - elongation_m / plant.jaw_pulley_radius_m)
    return estimated


def _fill_gaps(rig: Rig, runs: Sequence[Run]) -> _Plan:
    changes: dict[str, object] = {}
    ratio_from = constant_from = "rig"
    jaw_radius_m = rig.forceps.jaw_pulley_radius_m.value
    if rig.forceps.motor_pulley_radius_m.value is None and jaw_radius_m is not None:
        ratio = _shared_slope([(run.columns["theta_m_rad"], run.columns["theta_j_rad"]) for run in runs])
        if not ratio > 0:
            raise UserError(
                f"the jaw turns {ratio:.3g} rad per rad of the spindle, which must be positive; correct the sign of "
                "one angle"
            )
        changes["forceps.motor_pulley_radius_m"] = ratio * jaw_radius_m
        ratio_from = "jaw angle over spindle angle, all runs"
    if rig.motor.torque_constant_N_m_per_A.value is None:
        both = [run.columns for run in runs if "current_A" in run.columns and "tau_m_N_m" in run.columns]
        if both:
            constant = _shared_slope([(columns["current_A"], columns["tau_m_N_m"]) for columns in both])
            if not constant > 0:
                raise UserError(
                    f"spindle torque changes by {constant:.3g} N m per A of current, which must be positive; correct "
                    "the sign of one of them"
                )
            changes["motor.torque_constant_N_m_per_A"] = constant
            constant_from = "spindle torque over current, all runs"
    filled = rig.with_changes(changes)
    return _Plan(filled, filled.plant(), ratio_from, constant_from)


def _shared_slope(pairs: Sequence[tuple[Array, Array]]) -> float:
    """Least-squares slope of y over x with one zero for all pairs; NaN when no x varies."""
    x = np.concatenate([x for x, _ in pairs])
    y = np.concatenate([y for _, y in pairs])
    x = x - np.mean(x)
    power = float(x @ x)
    return float(x @ (y - np.mean(y))) / power if power > 0 else float("nan")


def _describe(run: Run) -> RunInfo:
    theta = run.columns["theta_m_rad"]
    padded = 8 * len(theta)
    spectrum = np.abs(np.fft.rfft((theta - np.mean(theta)) * np.hanning(len(theta)), padded))
    frequency_Hz = float(np.argmax(spectrum)) / (padded * run.sample_time_s)
    return RunInfo(run.name, frequency_Hz, float(np.mean(run.columns["tau_w_N_m"])), len(run), run.notes)


def _spread(infos: Sequence[RunInfo]) -> set[str]:
    """Choose runs to draw: lowest, middle and highest load among those of the middle frequency."""
    middle = sorted(info.frequency_Hz for info in infos)[len(infos) // 2]
    there = [info for info in infos if abs(info.frequency_Hz - middle) < SAME_FREQUENCY_Hz]
    there.sort(key=lambda info: info.load_N_m)
    picks = np.linspace(0, len(there) - 1, min(DRAWN_RUNS, len(there))).round().astype(int)
    return {there[pick].name for pick in picks}


def _trace(run: Run, info: RunInfo, source: str, torque: Array, estimated: dict[str, Estimated]) -> Trace:
    return Trace(
        run=info,
        source=source,
        time_s=run.columns["time_s"],
        theta_m_rad=run.columns["theta_m_rad"],
        tau_m_N_m=torque,
        tau_w_measured_N_m=run.columns["tau_w_N_m"],
        theta_j_measured_rad=run.columns["theta_j_rad"],
        tau_w_estimated_N_m={method: values.tau_w_N_m for method, values in estimated.items()},
        theta_j_estimated_rad={method: values.theta_j_rad for method, values in estimated.items()},
    )


def _at_zero(trace: Trace, zeros: dict[Key, Zeros]) -> Trace:
    tau_w, theta_j = {}, {}
    for method in trace.tau_w_estimated_N_m:
        tau_zero, theta_zero = zeros[trace.source, method, WHOLE]
        tau_w[method] = trace.tau_w_estimated_N_m[method] + (tau_zero or 0.0)
        theta_j[method] = trace.theta_j_estimated_rad[method] + (theta_zero or 0.0)
    return trace._replace(tau_w_estimated_N_m=tau_w, theta_j_estimated_rad=theta_j)


def _fitted(plan: _Plan, zeros: dict[Key, Zeros]) -> Fitted:
    return Fitted(
        radius_ratio=plan.plant.motor_pulley_radius_m / plan.plant.jaw_pulley_radius_m,
        radius_ratio_from=plan.ratio_from,
        torque_constant_N_m_per_A=plan.plant.torque_constant_N_m_per_A,
        torque_constant_from=plan.torque_constant_from,
        zeros={"/".join(filter(None, key)): pair for key, pair in zeros.items()},
    )


def _assumed(plan: _Plan) -> tuple[str, ...]:
    fitted = {"motor_pulley_radius_m": plan.ratio_from, "torque_constant_N_m_per_A": plan.torque_constant_from}
    return tuple(
        f"{name} = {value:g}" for name, value in plan.plant._asdict().items() if fitted.get(name, "rig") == "rig"
    )


def _tell(progress: Progress | None, done: int, total: int, what: str) -> None:
    if progress:
        progress(done, total, what)
