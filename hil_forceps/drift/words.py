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
    ("forceps.motor_viscous_N_m_s_per_rad", "rises"): "thicker or colder grease",
    ("forceps.motor_viscous_N_m_s_per_rad", "falls"): "lost or warmer grease",
    ("forceps.motor_coulomb_N_m", "rises"): "worn or dirty bearings or seals, a dragging brush or guide",
    ("forceps.motor_coulomb_N_m", "falls"): "running in",
    ("forceps.jaw_coulomb_N_m", "rises"): "wear or dirt in the jaw's joint, a wire dragging on its guides",
    ("forceps.jaw_coulomb_N_m", "falls"): "running in",
    ("forceps.wire_stiffness_N_per_m", "falls"): "a stretched wire, broken strands, a loose clamp",
    ("forceps.wire_stiffness_N_per_m", "rises"): "a wire that has bedded in, was replaced or was tightened",
    ("motor.torque_constant_N_m_per_A", "falls"): "warmer or weaker magnets, a drifting current sensor",
    ("motor.torque_constant_N_m_per_A", "rises"): "a drifting current sensor",
    ("forceps.jaw_pulley_radius_m", "rises"): "a wire that climbs on its pulley, an encoder's scale",
    ("forceps.jaw_pulley_radius_m", "falls"): "a worn groove, an encoder's scale",
}


def name_of(parameter: str) -> str:
    """Return a parameter in words."""
    return _NAMES.get(parameter, parameter)


def behind(parameter: str, direction: str) -> str:
    """Return what may be behind a change, "" where nothing usual is known."""
    return _BEHIND.get((parameter, direction), "")
