"""Presliding friction: micro-slip of the motor's friction before sliding."""

from hil_forceps.effects.entry import Effect, Grid, Parameter

EFFECT = Effect(
    "presliding_friction",
    "motor",
    "micro-slip of the motor's friction before sliding",
    "F_m += L z,  ż = ω_m (1 − z sgn ω_m)/δ",
    (
        Parameter("level_N_m", "N_m", 0.0, 1.0, 0.0, 1e-4, "friction once it slides, L"),
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
    "P. R. Dahl, Aerospace Corp. TOR-0158(3107-18)-1, 1968; LuGre: Canudas de Wit et al., IEEE TAC 40(3), 1995",
    "small motions and reversals",
    changes="torque",
)
