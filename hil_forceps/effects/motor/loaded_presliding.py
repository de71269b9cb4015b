"""Loaded presliding: friction that grows with the tension of the wire and builds up over a displacement."""

from hil_forceps.effects.entry import Effect, Grid, Parameter

# Plausible: steel cables on steel and in sheaths have μ of 0.05 to 0.3, dry ones up to 0.6.
EFFECT = Effect(
    "loaded_presliding",
    "motor",
    "friction that grows with the tension of the wire and builds up over a way",
    "F_m += μ r_m |f| z,  ż = ω_m (1 − z sgn ω_m)/δ",
    (
        Parameter(
            "mu", "", 0.0, 2.0, 0.0, 0.02, "friction torque over tension times radius once it slides, μ", plausible=0.6
        ),
        Parameter(
            "angle_rad",
            "rad",
            1e-5,
            2.0,
            None,
            0.02,
            "angle over which it builds up, δ",
            search_grid=Grid("angle_range_rad", (0.003, 0.02, 0.1)),
            hidden=(5.0e-3, 5.0e-2),
        ),
    ),
    "sheath as a chain of Dahl elements: Palli, Melchiorri, ICRA 2006; Do et al., Mechatronics 24(1), 2014",
    "reversals under different loads",
    changes="torque",
)
