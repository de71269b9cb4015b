"""Motor current between samples of the drive: dead time and lag, exact, with the instant at which a command arrives."""

import math
from typing import NamedTuple

from hil_forceps.model.kernel import inlined, subroutine

_MAX_SERIES_ARGUMENT = 1e-3  # below: series; omitted are 4e-11 of the mean, 2e-10 of the slope


class CurrentStep(NamedTuple):
    """Coefficients of the current over a step, the same for all samples."""

    whole_samples: int  # of dead time
    switch_step: int  # step of a sample in which the delayed command arrives
    mean: float  # share of the deviation from the command in the step's mean
    slope: float
    end: float
    arrival_mean: float  # share of a command that arrives in the step
    arrival_slope: float
    arrival_end: float


@subroutine
def _decay(a: float) -> tuple[float, float, float]:
    """Return mean, slope and end of exp(−a τ), τ from 0 to 1."""
    if a < _MAX_SERIES_ARGUMENT:
        return 1.0 - 0.5 * a + a * a / 6.0, -a + 0.5 * a * a, math.exp(-a)
    end = math.exp(-a)
    mean = (1.0 - end) / a
    return mean, 12.0 * ((1.0 - end * (1.0 + a)) / (a * a) - 0.5 * mean), end


@subroutine
def current_step(step_s: float, steps: int, delay_s: float, lag_s: float) -> CurrentStep:
    """Return the coefficients for a dead time and a time constant; `steps` in a sample of the drive."""
    samples = delay_s / (step_s * steps)
    whole = math.floor(samples + 1e-9)
    into = max(0.0, samples - whole) * steps
    switch = min(steps - 1, math.floor(into))
    share = min(1.0, into - switch)
    rest = 1.0 - share
    mean, slope, end = 0.0, 0.0, 0.0
    arrival_mean, arrival_slope, arrival_end = rest, 6.0 * share * rest, 1.0
    if lag_s > 0.0:
        a = step_s / lag_s
        mean, slope, end = _decay(a)
        # The command acts over the rest of the step as 1 − exp, which has mean 1 − m and slope −n there.
        m, n, last = _decay(a * rest)
        arrival_mean = rest * (1.0 - m)
        first_moment = 0.5 * share * rest * (1.0 - m) - rest * rest * n / 12.0
        arrival_slope = 12.0 * first_moment
        arrival_end = 1.0 - last
    return CurrentStep(whole, switch, mean, slope, end, arrival_mean, arrival_slope, arrival_end)


@inlined
def current_over(c: CurrentStep, step: int, current_A: float, old_A: float, new_A: float) -> tuple[float, float, float]:
    """Return mean, slope and end of the current over step `step` of a sample.

    `current_A`: at the start of the step; `old_A`, `new_A`: delayed commands before and after the arrival.
    """
    command, arriving = (old_A, new_A - old_A) if step <= c.switch_step else (new_A, 0.0)
    if step < c.switch_step:
        arriving = 0.0
    away = current_A - command
    return (
        command + away * c.mean + arriving * c.arrival_mean,
        away * c.slope + arriving * c.arrival_slope,
        command + away * c.end + arriving * c.arrival_end,
    )
