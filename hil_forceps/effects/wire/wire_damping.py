"""Wire damping: viscous damping of the wire."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "wire_damping",
    "wire",
    "viscous damping of the wire",
    "f += c ẋ",
    (Parameter("damping_N_s_per_m", "N_s_per_m", 0.0, 1e3, 0.0, 0.3, "c"),),
    "Kelvin-Voigt solid",
    "fast motion, steps of the load",
    corrected=False,
)
