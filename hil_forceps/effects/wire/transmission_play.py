"""Transmission play: lost motion behind the motor's encoder at each reversal, held by friction."""

from hil_forceps.effects.entry import Effect, Parameter, Size

# Play that no friction holds is a dead zone of the tension: `wire_slack` with δ = r_m ψ. No sensor distinguishes them.
EFFECT = Effect(
    "transmission_play",
    "motor",
    "lost motion behind the motor's encoder at each reversal, held by friction: play of a gear, slack guides",
    "θ_p = θ_m − p,  ṗ = ω_m within |p| ≤ ψ (play operator); the wire is wound by θ_p, its pull reaches the motor",
    (
        Parameter(
            "half_width_rad",
            "rad",
            0.0,
            0.5,
            0.0,
            2e-3,
            "half the lost motion at the motor pulley, ψ",
            size=Size(0.01, "angle_range_rad", at_most_typical=True),
        ),
    ),
    "Krasnosel'skii, Pokrovskii, Systems with Hysteresis, 1989 (play); Nordin, Gutman, Automatica 38(10), 2002",
    "reversals under tension that keeps its sign, and a jaw sensor",
    changes="wire",
)
