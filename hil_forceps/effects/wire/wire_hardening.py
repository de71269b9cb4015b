"""Wire hardening: stiffness grows with stretch."""

from hil_forceps.effects.entry import Effect, Parameter, Size

EFFECT = Effect(
    "wire_hardening",
    "wire",
    "stiffness grows with stretch",
    "f = k d (1 + β d²)",
    (Parameter("beta_per_m2", "per_m2", 0.0, 1e13, 0.0, 1e7, "β", size=Size(0.05, "stretch_range_m", power=-2)),),
    "stranded wire: Costello, Theory of Wire Rope, 1997; cubic spring of Duffing",
    "several levels of load",
    changes="wire",
)
