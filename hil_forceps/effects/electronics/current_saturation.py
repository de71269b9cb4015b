"""Current saturation: the current is limited below the limit configured."""

from hil_forceps.effects.entry import Effect, Grid, Parameter

EFFECT = Effect(
    "current_saturation",
    "motor",
    "the current is limited below the limit configured",
    "i = clip(i_ref, ±limit)",
    (
        Parameter(
            "limit_A",
            "A",
            0.0,
            200.0,
            None,
            0.2,
            "the limit that acts",
            search_grid=Grid("current_max_A", (0.9985, 0.995, 0.98, 0.85, 0.6)),
            hidden=(0.2, 0.2),
        ),
    ),
    "supply voltage, thermal protection",
    "commands above the limit",
    corrected=False,
)
