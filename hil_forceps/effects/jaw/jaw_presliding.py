"""Jaw presliding: friction at the jaw that builds up over a displacement, partly with the tension of the wire."""

from hil_forceps.effects.entry import Effect, Grid, Parameter

# Plausible: steel cables on steel and in sheaths have μ of 0.05 to 0.3, dry ones up to 0.6.
EFFECT = Effect(
    "jaw_presliding",
    "jaw",
    "friction at the jaw that builds up over a way, partly with the tension of the wire (pin, guides)",
    "F_j += (L + μ r_j |f|) z,  ż = ω_j (1 − z sgn ω_j)/δ",
    (
        Parameter("level_N_m", "N_m", 0.0, 0.1, 0.0, 1e-5, "friction without tension once it slides, L"),
        Parameter(
            "mu", "", 0.0, 0.9, 0.0, 0.02, "friction torque over tension times radius once it slides, μ", plausible=0.6
        ),
        Parameter(
            "angle_rad",
            "rad",
            1e-5,
            2.0,
            None,
            0.02,
            "angle over which it builds up, δ",
            search_grid=Grid("jaw_range_rad", (0.003, 0.02, 0.1)),
            hidden=(5.0e-3, 5.0e-2),
        ),
    ),
    "P. R. Dahl 1968; sheath as a chain of such elements: Palli, Melchiorri, ICRA 2006",
    "reversals of the jaw under different loads, and a jaw sensor",
    changes="torque",
    one_by_one=True,
)
