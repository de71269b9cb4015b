"""Wire hysteresis: rate-independent loop of tension over stretch."""

from hil_forceps.effects.entry import Effect, Grid, Parameter

EFFECT = Effect(
    "wire_hysteresis",
    "wire",
    "rate-independent loop of tension over stretch",
    "f += h z,  ż = ẋ (1 − z sgn ẋ)/s",
    (
        Parameter("force_N", "N", 0.0, 100.0, 0.0, 0.02, "half height of the loop, h"),
        Parameter(
            "stretch_m",
            "m",
            1e-8,
            2e-3,
            None,
            5e-6,
            "stretch over which it builds up, s",
            search_grid=Grid("stretch_range_m", (0.03, 0.15, 0.6)),
            hidden=(5.0e-6, 4.0e-5),
        ),
    ),
    "Bouc 1967, Wen 1976 (A = 1, β = γ, n = 1), the same as Dahl 1968 over stretch",
    "load that rises and falls again",
    changes="wire",
)
