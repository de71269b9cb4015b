"""Electrical lag: the current lags its reference."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "electrical_lag",
    "timing",
    "the current lags its reference",
    "di/dt = (i_ref − i)/T",
    (Parameter("time_constant_s", "s", 0.0, 0.1, 0.0, 2e-4, "L/R or the current loop's, T"),),
    "armature circuit of a motor",
    "fast changes of the current",
)
