"""Actuation delay: dead time from command to current."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "actuation_delay",
    "timing",
    "dead time from command to current",
    "i(t) = i_ref(t − T_d)",
    (Parameter("delay_s", "s", 0.0, 0.1, 0.0, 5e-4, "T_d"),),
    "computation and communication delay",
    "fast changes of the current",
)
