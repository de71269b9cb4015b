"""How often the drift test is right: false alarms without a change, power and onsets with one, by simulation.

    python -m tests.trend.rates 400

Estimates are drawn from their distribution. Prints the tables of docs/trend.md.
Whether the intervals of sessions hold the truth:

    python -m tests.trend.rates --intervals 60
"""

import argparse
import sys
from typing import NamedTuple

import joblib
import numpy as np

from hil_forceps.diagnosis.result import TWO_SIDED_95
from hil_forceps.drift.change_test import change_test
from hil_forceps.drift.family import Estimated, instrument_trend
from hil_forceps.drift.result import When
from hil_forceps.drift.scatter import Scatter, drawn
from hil_forceps.drift.series import follow
from hil_forceps.drift.session_fit import fit_session
from tests.trend.simulated_sessions import ASSUMED, FRICTION, run_of

RATE, PARAMETERS = 0.05, 8
SCATTERS = (
    Scatter(0.0, 3.0),
    Scatter(0.6, 1.0),
    Scatter(0.6, 10.0),
    Scatter(0.9, 5.0),
    Scatter(1.0, 0.3),
    Scatter(1.0, 30.0),
)


class Wear(NamedTuple):
    """A change that is hidden."""

    what: str
    sessions: int
    onset: int
    rise: float
    over: int  # sessions
    scatter: Scatter  # as a share of the level
    deviation: float  # of a session's own error, likewise


WEARS = (
    Wear("+30 % over 50 sessions, scatter 3 %", 100, 50, 0.3, 50, Scatter(0.0, 0.03), 0.004),
    Wear("+30 % over 50 sessions, scatter 5 %, φ = 0.6", 100, 50, 0.3, 50, Scatter(0.6, 0.04), 0.004),
    Wear("+30 % over 50 sessions, scatter 10 %", 100, 50, 0.3, 50, Scatter(0.0, 0.1), 0.02),
    Wear("+10 % at once, scatter 3 %, φ = 0.3", 60, 30, 0.1, 1, Scatter(0.3, 0.0286), 0.004),
    Wear("−5 % over 50 sessions, scatter 0.5 %", 100, 50, -0.05, 50, Scatter(0.0, 0.005), 1e-3),
)


def is_alarm(seed: int, sessions: int, scatter: Scatter) -> bool:
    """Tell whether a series without a change is an alarm."""
    rng = np.random.default_rng([seed, sessions])
    deviations = rng.uniform(0.7, 1.4, sessions)
    return change_test(drawn(rng, deviations, scatter, 1)[:, 0], deviations, [], RATE, rng).p_value <= RATE


def is_alarm_of_instrument(seed: int) -> bool:
    """Tell whether an instrument with eight parameters, none of which changes, is an alarm."""
    rng = np.random.default_rng([seed, 8])
    sessions = tuple(When(f"{k:03}", "2026-01-01T00:00:00Z") for k in range(30))
    parameters = []
    for place in range(PARAMETERS):
        deviations = rng.uniform(0.7, 1.4, 30)
        values = 100.0 + drawn(rng, deviations, SCATTERS[place % len(SCATTERS)], 1)[:, 0]
        parameters.append(Estimated(f"p{place}", "", 1.0, sessions, tuple(values.tolist()), tuple(deviations.tolist())))
    return any(p.changes for p in instrument_trend("a", parameters, RATE, seed).parameters)


def found(seed: int, wear: Wear) -> tuple[bool, int, bool, float]:
    """Return whether a change is found, the error of its onset, whether the interval holds it, and the whole change."""
    rng = np.random.default_rng([seed, wear.sessions])
    deviations = wear.deviation * rng.uniform(0.7, 1.4, wear.sessions)
    worn = wear.rise * np.clip((np.arange(wear.sessions) - wear.onset + 1) / wear.over, 0.0, 1.0)
    series = 1.0 + worn + drawn(rng, deviations, wear.scatter, 1)[:, 0]
    changes = follow(series, deviations, RATE / PARAMETERS, rng).changes
    if not changes:
        return False, 0, False, 0.0
    onset = changes[0].onset
    total = sum(change.total for change in changes)
    return True, onset.likeliest - wear.onset, onset.low <= wear.onset <= onset.high, total


def intervals(sessions: int) -> None:
    """Fit sessions of 12 s that differ as sessions do, and print how many 95 % intervals hold the truth."""
    inside: dict[str, list[bool]] = {}
    for number in range(sessions):
        run, true = run_of(number, {FRICTION: 1.0 + 0.006 * number}, 11, 12.0)
        for p in fit_session([run], ASSUMED).parameters:
            if not p.reason:
                off = p.value - getattr(true.plant(), p.name.partition(".")[2])
                inside.setdefault(p.name, []).append(abs(off) < TWO_SIDED_95 * p.sd)
    for name, each in inside.items():
        sys.stdout.write(f"{name}: {sum(each)} of {len(each)}\n")
    every = [one for each in inside.values() for one in each]
    sys.stdout.write(f"all: {sum(every)} of {len(every)}, {100.0 * np.mean(every):.1f} %\n")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("series", type=int, nargs="?", default=200)
    parser.add_argument("--intervals", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    told = parser.parse_args()
    if told.intervals:
        intervals(told.intervals)
        return
    pool, seeds = joblib.Parallel(n_jobs=told.jobs, batch_size=4), range(told.series)
    for sessions in (12, 40):
        for scatter in SCATTERS:
            count = sum(pool(joblib.delayed(is_alarm)(seed, sessions, scatter) for seed in seeds))
            line = (
                f"{sessions} sessions, φ {scatter.correlation}, e {scatter.deviation}: {count} of {told.series} alarms"
            )
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
    count = sum(pool(joblib.delayed(is_alarm_of_instrument)(seed) for seed in seeds))
    sys.stdout.write(f"instruments of {PARAMETERS} parameters, 30 sessions: {count} of {told.series} alarms\n")
    for wear in WEARS:
        each = list(pool(joblib.delayed(found)(seed, wear) for seed in range(told.series // 4)))
        hits = [one for one in each if one[0]]
        errors = np.array([one[1] for one in hits])
        off, most_off = np.quantile(np.abs(errors), (0.5, 0.9))
        totals = [one[3] for one in hits]
        sys.stdout.write(
            f"{wear.what}: found {len(hits)} of {len(each)}; onset off by {off:.0f} sessions (median), {most_off:.0f} "
            f"(90 %); interval holds it {sum(one[2] for one in hits)} times; whole change {np.mean(totals):+.3f} ± "
            f"{np.std(totals):.3f}\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
