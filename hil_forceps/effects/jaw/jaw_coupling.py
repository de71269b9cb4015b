"""Jaw coupling: spring between the jaw and what it is coupled to at rest: the other jaw, its wire, the wrist."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "jaw_coupling",
    "jaw",
    "spring between the jaw and what it is coupled to at rest: the other jaw, its wire, the wrist",
    "coupling = k_c θ_j + τ_c, a load on the jaw",
    (
        Parameter("stiffness_N_m_per_rad", "N_m_per_rad", 0.0, 0.1, 0.0, 2e-5, "stiffness, k_c"),
        Parameter("torque_N_m", "N_m", -0.1, 0.1, 0.0, 1e-5, "torque at angle zero, τ_c"),
    ),
    "coupled tendon-driven joints: Tsai, Robot Analysis, 1999 (chapter 10); Hooke's law",
    "the jaw over a wide range of angles, at one load",
    by_angle=True,
    changes="torque",
)


def jaw_load_N_m(stiffness_N_m_per_rad: float, torque_N_m: float, theta_j_rad: float) -> float:
    """Return the load on the jaw by the coupling."""
    return stiffness_N_m_per_rad * theta_j_rad + torque_N_m
