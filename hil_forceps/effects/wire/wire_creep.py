"""Wire creep: slow visco-elastic stretch under load that recovers."""

from hil_forceps.effects.entry import Effect, Grid, Parameter

# Plausible: cables creep by some per cent of their stretch, fibre ropes by up to a third.
EFFECT = Effect(
    "wire_creep",
    "wire",
    "slow visco-elastic stretch under load that recovers",
    "ẋ_c = (s f/k − x_c)/T",
    (
        Parameter("share", "", 0.0, 5.0, 0.0, 0.02, "slow stretch over elastic stretch in the end, s", plausible=0.35),
        Parameter(
            "time_constant_s",
            "s",
            1e-2,
            1e4,
            None,
            2.0,
            "time constant",
            search_grid=Grid("", (0.03, 0.15, 0.7, 3.0)),
            hidden=(0.1, 2.0),
        ),
    ),
    "standard linear solid: C. Zener 1948",
    "a load held for longer than the time constant, and released",
    changes="wire",
)
