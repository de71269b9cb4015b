"""Amplifier deadband: small commands give no current."""

from hil_forceps.effects.entry import Effect, Parameter, Size

EFFECT = Effect(
    "amplifier_deadband",
    "motor",
    "small commands give no current",
    "i = dz(i_ref, w)",
    (Parameter("half_width_A", "A", 0.0, 5.0, 0.0, 3e-3, "w", size=Size(0.01, "current_max_A")),),
    "dead time of a bridge: Jeong, Park, IEEE TIE 38(2), 1991",
    "commands that change their sign",
    corrected=False,
)
