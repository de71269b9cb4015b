"""Wire slack: dead zone of the wire around zero tension, both ways (backlash)."""

from hil_forceps.effects.entry import Effect, Parameter, Size

EFFECT = Effect(
    "wire_slack",
    "wire",
    "dead zone of the wire around zero tension, both ways (backlash)",
    "d = dz(e, δ)",
    (
        Parameter(
            "half_width_m", "m", 0.0, 2e-3, 0.0, 1e-6, "half the dead zone, δ", size=Size(0.02, "stretch_range_m")
        ),
    ),
    "Nordin, Gutman, Automatica 38(10), 2002 (backlash)",
    "tension that changes its sign",
    changes="wire",
)
