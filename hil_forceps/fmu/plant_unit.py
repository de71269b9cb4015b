"""The plant as a unit: motor, wire and jaw with every effect, the sensors, and the drive's position loop."""

import math

from hil_forceps.fmu import plant_kernels as k
from hil_forceps.fmu.rig_numbers import rig_numbers
from hil_forceps.fmu.unit import Causality, Unit, Variability, Variable
from hil_forceps.model.parameters import NAMES, vector
from hil_forceps.rig import Rig
from hil_forceps.rig.sections import MAX_ENCODER_COUNTS, DriveLaw

_DEFAULT_SAMPLE_TIME_S = 1e-3
_DEFAULT_STEPS = 4
_NO_LIMIT = 1e30  # in place of infinity, which not every importer reads
# What acts on recordings alone: in a loop there is no channel that a log could have shifted.
LEFT_OUT = "channel_skew"
# A change would need another length of the memory, or comes too late.
_FIXED_EFFECT = "effects.actuation_delay.delay_s"


def plant_unit(rig: Rig, sample_time_s: float | None = None) -> Unit:
    """Return the plant's unit for a rig; UserError when the rig doesn't know a value of the plant.

    A sample is the drive's, or `sample_time_s`. Without `drive` in the rig the current is commanded from outside.
    """
    law = rig.drive
    if sample_time_s is None:
        sample_time_s = _DEFAULT_SAMPLE_TIME_S if law is None else law.sample_time_s
    variables = (*_plant(rig), *_drive(rig, law, sample_time_s), *_signals())
    assert len(variables) == k.VALUES
    return Unit(
        "hil_forceps_plant",
        "Wire-actuated forceps with motor, drive and sensors",
        variables,
        k.MEMORY,
        k.begin,
        k.prepare,
        k.advance,
        k.PROBLEMS,
        sample_time_s,
        k.SAMPLE_TIME,
    )


def _plant(rig: Rig) -> list[Variable]:
    """Return the numbers of the plant and of every effect, in the order of `Physics`."""
    known = rig_numbers()
    variables = []
    for name, value in zip(NAMES, vector(rig).tolist(), strict=True):
        unit, low, high, meaning = known[name]
        left_out = name.startswith(f"effects.{LEFT_OUT}.")
        variability: Variability = "fixed" if name == _FIXED_EFFECT else "tunable"
        start = 0.0 if left_out else min(value, _NO_LIMIT)
        causality: Causality = "parameter"
        if left_out:
            causality, variability, meaning = "local", "constant", f"acts in recordings alone, not here; {meaning}"
        high = math.inf if name == "effects.current_saturation.limit_A" else high
        variables.append(Variable(name, unit, causality, variability, start, meaning, "real", low, high))
    return variables


def _drive(rig: Rig, law: DriveLaw | None, sample_time_s: float) -> list[Variable]:
    known = rig_numbers()
    variables = []
    gains = ("kp_A_per_rad", "ki_A_per_rad_s", "kd_A_s_per_rad", "derivative_cutoff_Hz", "cascade_time_s")
    for key in ("sample_time_s", *gains):
        unit, low, high, meaning = known[f"drive.{key}"]
        fallback = 1.0 if key == "derivative_cutoff_Hz" else 0.0
        value = sample_time_s if key == "sample_time_s" else getattr(law, key, fallback)
        variability: Variability = "fixed" if key == "sample_time_s" else "tunable"
        variables.append(Variable(f"drive.{key}", unit, "parameter", variability, value, meaning, "real", low, high))
    unit, low, high, meaning = known["drive.current_limit_A"]
    limit = 1.0 if law is None else law.current_limit_A
    counts = 0 if rig.encoder.counts_per_rev is None else rig.encoder.counts_per_rev
    return [
        *variables,
        Variable("drive.current_limit_A", unit, "parameter", "tunable", limit, meaning, "real", low, high),
        _whole("encoder.counts_per_rev", counts, 0, MAX_ENCODER_COUNTS, "counts of a revolution; 0: not rounded"),
        Variable(
            "position_loop", "", "parameter", "fixed", float(law is not None),
            "true: the drive's law follows theta_m_ref_rad; false: current_ref_A is the command", "boolean",
        ),
        _whole("plant_steps_per_sample", _DEFAULT_STEPS, 1, k.MAX_STEPS, "steps of the plant in a sample of the drive"),
        _start("start.theta_m_rad", "rad", "angle of the motor at the start, at rest"),
        _start("start.tension_N", "N", "tension of the wire at the start"),
        _start("start.current_A", "A", "current at the start"),
    ]  # fmt: skip


def _whole(name: str, start: int, low: int, high: int, meaning: str) -> Variable:
    return Variable(name, "", "parameter", "fixed", float(start), meaning, "integer", float(low), float(high))


def _start(name: str, unit: str, meaning: str) -> Variable:
    return Variable(name, unit, "parameter", "fixed", 0.0, meaning)


def _signals() -> list[Variable]:
    inputs = (
        ("theta_m_ref_rad", "rad", "reference of the motor angle, for the position loop"),
        ("current_ref_A", "A", "commanded current, without the position loop"),
        ("tau_w_N_m", "N_m", "load on the jaw, held over a communication step"),
    )
    outputs = (
        ("theta_m_rad", "rad", "motor angle as the encoder shows it"),
        ("current_A", "A", "current as its sensor shows it"),
        ("theta_j_rad", "rad", "jaw angle"),
        ("tau_w_held_N_m", "N_m", "load on the jaw of the last sample"),
        ("tension_N", "N", "tension of the wire"),
        ("elongation_m", "m", "elongation of the wire"),
        ("omega_m_rad_per_s", "rad_per_s", "speed of the motor"),
        ("omega_j_rad_per_s", "rad_per_s", "speed of the jaw"),
        ("theta_m_true_rad", "rad", "motor angle as it is"),
        ("current_true_A", "A", "current as it is"),
        ("current_command_A", "A", "current that the drive's law commands"),
    )
    return [
        *(Variable(name, unit, "input", "continuous", 0.0, meaning) for name, unit, meaning in inputs),
        *(Variable(name, unit, "output", "continuous", 0.0, meaning) for name, unit, meaning in outputs),
    ]
