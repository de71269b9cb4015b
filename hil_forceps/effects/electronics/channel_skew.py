"""Channel skew: a channel is stamped late against the others."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "channel_skew",
    "timing",
    "a channel is stamped late against the others",
    "recorded(t) = true(t − T_s)",
    (
        Parameter("theta_m_s", "s", -0.1, 0.1, 0.0, 1e-3, "of theta_m_rad"),
        Parameter("current_s", "s", -0.1, 0.1, 0.0, 1e-3, "of current_A (or tau_m_N_m)"),
        Parameter("theta_j_s", "s", -0.1, 0.1, 0.0, 1e-3, "of theta_j_rad"),
        Parameter("tau_w_s", "s", -0.1, 0.1, 0.0, 1e-3, "of tau_w_N_m"),
    ),
    "data acquisition on more than one clock",
    "fast changes of two channels that belong together",
    corrected=False,
    one_by_one=True,
)
