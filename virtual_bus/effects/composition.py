"""Numbers of all effects, and the sums over them at each place where they act.

Written by tools/generation/compose_effects.py from the files in `virtual_bus/effects`; not to be edited.
"""

from typing import NamedTuple

from virtual_bus.effects.electronics import encoder_eccentricity, encoder_scale
from virtual_bus.effects.jaw import jaw_coupling, jaw_gravity, jaw_position_friction, jaw_viscous_friction
from virtual_bus.effects.motor import (
    cogging,
    coulomb_asymmetry,
    film_friction,
    load_dependent_friction,
    stribeck_friction,
    torque_constant_drift,
    torque_ripple,
    viscous_asymmetry,
    viscous_drift,
)
from virtual_bus.effects.wire import pulley_eccentricity, spool_radius_change, transmission_curve
from virtual_bus.kernel import subroutine
from virtual_bus.plant.plant import TruthParameters

_stribeck_friction__motor_friction_N_m = subroutine(stribeck_friction.motor_friction_N_m)
_load_dependent_friction__motor_friction_N_m = subroutine(load_dependent_friction.motor_friction_N_m)
_coulomb_asymmetry__motor_friction_N_m = subroutine(coulomb_asymmetry.motor_friction_N_m)
_film_friction__motor_friction_N_m = subroutine(film_friction.motor_friction_N_m)
_viscous_asymmetry__motor_drag_N_m = subroutine(viscous_asymmetry.motor_drag_N_m)
_cogging__motor_torque_N_m = subroutine(cogging.motor_torque_N_m)
_torque_ripple__relative_torque = subroutine(torque_ripple.relative_torque)
_torque_constant_drift__relative_torque_constant = subroutine(torque_constant_drift.relative_torque_constant)
_viscous_drift__relative_viscosity = subroutine(viscous_drift.relative_viscosity)
_pulley_eccentricity__wound_m = subroutine(pulley_eccentricity.wound_m)
_spool_radius_change__wound_m = subroutine(spool_radius_change.wound_m)
_pulley_eccentricity__radius_m = subroutine(pulley_eccentricity.radius_m)
_spool_radius_change__radius_m = subroutine(spool_radius_change.radius_m)
_transmission_curve__taken_m = subroutine(transmission_curve.taken_m)
_transmission_curve__lever_m = subroutine(transmission_curve.lever_m)
_jaw_gravity__jaw_load_N_m = subroutine(jaw_gravity.jaw_load_N_m)
_jaw_coupling__jaw_load_N_m = subroutine(jaw_coupling.jaw_load_N_m)
_jaw_viscous_friction__jaw_load_N_m = subroutine(jaw_viscous_friction.jaw_load_N_m)
_jaw_position_friction__jaw_friction_N_m = subroutine(jaw_position_friction.jaw_friction_N_m)
_encoder_eccentricity__encoder_error_rad = subroutine(encoder_eccentricity.encoder_error_rad)
_encoder_scale__encoder_error_rad = subroutine(encoder_scale.encoder_error_rad)


class EffectNumbers(NamedTuple):
    """Every parameter of every effect in the order of the catalogue; SI."""

    stribeck_friction_rise_N_m: float
    stribeck_friction_speed_rad_per_s: float
    presliding_friction_level_N_m: float
    presliding_friction_angle_rad: float
    load_dependent_friction_mu: float
    coulomb_asymmetry_difference_N_m: float
    viscous_drift_relative_change: float
    viscous_drift_time_constant_s: float
    jaw_position_friction_slope_N_m_per_rad: float
    jaw_position_friction_curvature_N_m_per_rad2: float
    jaw_gravity_sine_N_m: float
    jaw_gravity_cosine_N_m: float
    wire_slack_half_width_m: float
    wire_hardening_beta_per_m2: float
    wire_hysteresis_force_N: float
    wire_hysteresis_stretch_m: float
    wire_creep_share: float
    wire_creep_time_constant_s: float
    wire_damping_damping_N_s_per_m: float
    wire_permanent_stretch_stretch_m: float
    torque_constant_drift_relative_change: float
    torque_constant_drift_time_constant_s: float
    cogging_sine_N_m: float
    cogging_cosine_N_m: float
    cogging_harmonic: float
    torque_ripple_sine: float
    torque_ripple_cosine: float
    torque_ripple_harmonic: float
    current_offset_offset_A: float
    current_gain_relative_error: float
    amplifier_deadband_half_width_A: float
    electrical_lag_time_constant_s: float
    actuation_delay_delay_s: float
    channel_skew_theta_m_s: float
    channel_skew_current_s: float
    channel_skew_theta_j_s: float
    channel_skew_tau_w_s: float
    encoder_eccentricity_sine_rad: float
    encoder_eccentricity_cosine_rad: float
    encoder_scale_relative_error: float
    pulley_eccentricity_sine: float
    pulley_eccentricity_cosine: float
    spool_radius_change_pitch_m_per_turn: float
    current_saturation_limit_A: float
    transmission_play_half_width_rad: float
    transmission_curve_sine: float
    transmission_curve_cosine: float
    jaw_coupling_stiffness_N_m_per_rad: float
    jaw_coupling_torque_N_m: float
    loaded_presliding_mu: float
    loaded_presliding_angle_rad: float
    viscous_asymmetry_difference_N_m_s_per_rad: float
    film_friction_level_N_m: float
    film_friction_speed_rad_per_s: float
    jaw_presliding_level_N_m: float
    jaw_presliding_mu: float
    jaw_presliding_angle_rad: float
    jaw_viscous_friction_viscosity_N_m_s_per_rad: float


@subroutine
def motor_friction_N_m(
    p: TruthParameters, e: EffectNumbers, side: float, omega_m_rad_per_s: float, tension_N: float
) -> float:
    """Return the motor's dry friction against motion to one side."""
    total = p.motor_coulomb_N_m
    total += _stribeck_friction__motor_friction_N_m(
        e.stribeck_friction_rise_N_m, e.stribeck_friction_speed_rad_per_s, omega_m_rad_per_s
    )
    total += _load_dependent_friction__motor_friction_N_m(
        e.load_dependent_friction_mu, p.motor_pulley_radius_m, tension_N
    )
    total += _coulomb_asymmetry__motor_friction_N_m(e.coulomb_asymmetry_difference_N_m, side)
    total += _film_friction__motor_friction_N_m(
        e.film_friction_level_N_m, e.film_friction_speed_rad_per_s, omega_m_rad_per_s
    )
    return total


@subroutine
def motor_drag_N_m(p: TruthParameters, e: EffectNumbers, omega_m_rad_per_s: float) -> float:
    """Return what else brakes the motor at a speed."""
    total = 0.0
    total += _viscous_asymmetry__motor_drag_N_m(e.viscous_asymmetry_difference_N_m_s_per_rad, omega_m_rad_per_s)
    return total


@subroutine
def motor_torque_N_m(p: TruthParameters, e: EffectNumbers, theta_m_rad: float) -> float:
    """Return the torque on the motor that comes without current."""
    total = 0.0
    total += _cogging__motor_torque_N_m(e.cogging_sine_N_m, e.cogging_cosine_N_m, e.cogging_harmonic, theta_m_rad)
    return total


@subroutine
def relative_torque(p: TruthParameters, e: EffectNumbers, theta_m_rad: float) -> float:
    """Return the relative change of the motor's torque with its angle."""
    total = 0.0
    total += _torque_ripple__relative_torque(
        e.torque_ripple_sine, e.torque_ripple_cosine, e.torque_ripple_harmonic, theta_m_rad
    )
    return total


@subroutine
def relative_torque_constant(p: TruthParameters, e: EffectNumbers, time_s: float) -> float:
    """Return the relative change of K_t at a time."""
    total = 0.0
    total += _torque_constant_drift__relative_torque_constant(
        e.torque_constant_drift_relative_change, e.torque_constant_drift_time_constant_s, time_s
    )
    return total


@subroutine
def relative_viscosity(p: TruthParameters, e: EffectNumbers, time_s: float) -> float:
    """Return the relative change of the motor's viscous friction."""
    total = 0.0
    total += _viscous_drift__relative_viscosity(
        e.viscous_drift_relative_change, e.viscous_drift_time_constant_s, time_s
    )
    return total


@subroutine
def wound_m(p: TruthParameters, e: EffectNumbers, theta_p_rad: float) -> float:
    """Return the wire wound up from angle 0 on."""
    total = p.motor_pulley_radius_m * theta_p_rad
    total += _pulley_eccentricity__wound_m(
        e.pulley_eccentricity_sine, e.pulley_eccentricity_cosine, p.motor_pulley_radius_m, theta_p_rad
    )
    total += _spool_radius_change__wound_m(e.spool_radius_change_pitch_m_per_turn, theta_p_rad)
    return total


@subroutine
def radius_m(p: TruthParameters, e: EffectNumbers, theta_p_rad: float) -> float:
    """Return the effective radius of the motor pulley."""
    total = p.motor_pulley_radius_m
    total += _pulley_eccentricity__radius_m(
        e.pulley_eccentricity_sine, e.pulley_eccentricity_cosine, p.motor_pulley_radius_m, theta_p_rad
    )
    total += _spool_radius_change__radius_m(e.spool_radius_change_pitch_m_per_turn, theta_p_rad)
    return total


@subroutine
def taken_m(p: TruthParameters, e: EffectNumbers, theta_j_rad: float) -> float:
    """Return the wire that the jaw has taken."""
    total = p.jaw_pulley_radius_m * theta_j_rad
    total += _transmission_curve__taken_m(
        e.transmission_curve_sine, e.transmission_curve_cosine, p.jaw_pulley_radius_m, theta_j_rad
    )
    return total


@subroutine
def lever_m(p: TruthParameters, e: EffectNumbers, theta_j_rad: float) -> float:
    """Return the lever at which the wire pulls the jaw."""
    total = p.jaw_pulley_radius_m
    total += _transmission_curve__lever_m(
        e.transmission_curve_sine, e.transmission_curve_cosine, p.jaw_pulley_radius_m, theta_j_rad
    )
    return total


@subroutine
def jaw_load_N_m(p: TruthParameters, e: EffectNumbers, theta_j_rad: float, omega_j_rad_per_s: float) -> float:
    """Return what acts on the jaw beside τ_w."""
    total = 0.0
    total += _jaw_gravity__jaw_load_N_m(e.jaw_gravity_sine_N_m, e.jaw_gravity_cosine_N_m, theta_j_rad)
    total += _jaw_coupling__jaw_load_N_m(e.jaw_coupling_stiffness_N_m_per_rad, e.jaw_coupling_torque_N_m, theta_j_rad)
    total += _jaw_viscous_friction__jaw_load_N_m(e.jaw_viscous_friction_viscosity_N_m_s_per_rad, omega_j_rad_per_s)
    return total


@subroutine
def jaw_friction_N_m(p: TruthParameters, e: EffectNumbers, theta_j_rad: float) -> float:
    """Return the jaw's dry friction, as long as it is any."""
    total = p.jaw_coulomb_N_m
    total += _jaw_position_friction__jaw_friction_N_m(
        e.jaw_position_friction_slope_N_m_per_rad, e.jaw_position_friction_curvature_N_m_per_rad2, theta_j_rad
    )
    return total


@subroutine
def encoder_angle(e: EffectNumbers, theta_m_rad: float) -> float:
    """Return θ_enc before it is counted."""
    total = theta_m_rad
    total += _encoder_eccentricity__encoder_error_rad(
        e.encoder_eccentricity_sine_rad, e.encoder_eccentricity_cosine_rad, theta_m_rad
    )
    total += _encoder_scale__encoder_error_rad(e.encoder_scale_relative_error, theta_m_rad)
    return total
