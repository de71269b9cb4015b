"""Changes of parameters in words: what rises or falls, and what may be behind it."""

_NAMES = {
    "forceps.motor_pulley_radius_m": "radius of the motor's pulley",
    "forceps.jaw_pulley_radius_m": "radius of the jaw's pulley",
    "forceps.motor_inertia_kg_m2": "inertia of the motor",
    "forceps.jaw_inertia_kg_m2": "inertia of the jaw",
    "forceps.motor_viscous_N_m_s_per_rad": "viscous friction of the motor",
    "forceps.motor_coulomb_N_m": "dry friction of the motor",
    "forceps.jaw_coulomb_N_m": "dry friction of the jaw",
    "forceps.wire_stiffness_N_per_m": "stiffness of the wire",
    "motor.torque_constant_N_m_per_A": "torque constant",
}
# What textbooks and data sheets give as usual causes; the data can't tell which it is.
_BEHIND = {
    ("forceps.motor_viscous_N_m_s_per_rad", "rises"): "grease that thickens or is colder",
    ("forceps.motor_viscous_N_m_s_per_rad", "falls"): "grease that is lost or warmer",
    ("forceps.motor_coulomb_N_m", "rises"): "worn or dirty bearings and seals, a brush or a guide that drags",
    ("forceps.motor_coulomb_N_m", "falls"): "running in",
    ("forceps.jaw_coulomb_N_m", "rises"): "wear or dirt in the jaw's joint, a wire that drags on its guides",
    ("forceps.jaw_coulomb_N_m", "falls"): "running in",
    ("forceps.wire_stiffness_N_per_m", "falls"): "a wire that stretches, strands that break, a clamp that gives",
    ("forceps.wire_stiffness_N_per_m", "rises"): "a wire that beds in, or was replaced or pulled tighter",
    ("motor.torque_constant_N_m_per_A", "falls"): "magnets that are warmer or weakened, a current sensor that drifts",
    ("motor.torque_constant_N_m_per_A", "rises"): "a current sensor that drifts",
    ("forceps.jaw_pulley_radius_m", "rises"): "a wire that rides up, an encoder's scale",
    ("forceps.jaw_pulley_radius_m", "falls"): "a worn groove, an encoder's scale",
}


def name_of(parameter: str) -> str:
    """Return a parameter in words."""
    return _NAMES.get(parameter, parameter)


def behind(parameter: str, direction: str) -> str:
    """Return what may be behind a change, "" where nothing usual is known."""
    return _BEHIND.get((parameter, direction), "")
