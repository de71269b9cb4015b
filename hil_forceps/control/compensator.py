"""What the motor must turn so that the jaw follows although the wire stretches."""

from hil_forceps.rig.plant import PlantParameters


def motor_reference_rad(theta_j_ref_rad: float, elongation_m: float, plant: PlantParameters) -> float:
    """Return θ_m^ref = (r_j θ_j^ref + x̂)/r_m, (10); with `elongation_m` 0 nothing is compensated."""
    return (plant.jaw_pulley_radius_m * theta_j_ref_rad + elongation_m) / plant.motor_pulley_radius_m
