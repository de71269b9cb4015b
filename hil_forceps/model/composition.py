"""The plant's numbers, and the sums over all effects at each place where they act.

Written by tools/generation/compose_effects.py from the files in `hil_forceps/effects`; not to be edited.
"""

from typing import NamedTuple

from hil_forceps.effects.electronics import encoder_eccentricity, encoder_scale
from hil_forceps.effects.jaw import jaw_coupling, jaw_gravity, jaw_position_friction
from hil_forceps.effects.motor import (
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
from hil_forceps.effects.wire import pulley_eccentricity, spool_radius_change, transmission_curve
from hil_forceps.model.kernel import inlined

_stribeck_friction__motor_friction_N_m = inlined(stribeck_friction.motor_friction_N_m)
_load_dependent_friction__motor_friction_N_m = inlined(load_dependent_friction.motor_friction_N_m)
_film_friction__motor_friction_N_m = inlined(film_friction.motor_friction_N_m)
_stribeck_friction__motor_friction_at_rest_N_m = inlined(stribeck_friction.motor_friction_at_rest_N_m)
_load_dependent_friction__motor_friction_at_rest_N_m = inlined(load_dependent_friction.motor_friction_at_rest_N_m)
_coulomb_asymmetry__forward_friction_N_m = inlined(coulomb_asymmetry.forward_friction_N_m)
_coulomb_asymmetry__backward_friction_N_m = inlined(coulomb_asymmetry.backward_friction_N_m)
_viscous_drift__motor_viscosity_N_m_s_per_rad = inlined(viscous_drift.motor_viscosity_N_m_s_per_rad)
_viscous_asymmetry__motor_viscosity_N_m_s_per_rad = inlined(viscous_asymmetry.motor_viscosity_N_m_s_per_rad)
_viscous_asymmetry__motor_drag_N_m = inlined(viscous_asymmetry.motor_drag_N_m)
_cogging__motor_torque_N_m = inlined(cogging.motor_torque_N_m)
_torque_ripple__relative_torque = inlined(torque_ripple.relative_torque)
_torque_constant_drift__relative_torque_constant = inlined(torque_constant_drift.relative_torque_constant)
_pulley_eccentricity__wound_m = inlined(pulley_eccentricity.wound_m)
_spool_radius_change__wound_m = inlined(spool_radius_change.wound_m)
_pulley_eccentricity__radius_m = inlined(pulley_eccentricity.radius_m)
_spool_radius_change__radius_m = inlined(spool_radius_change.radius_m)
_transmission_curve__paid_m = inlined(transmission_curve.paid_m)
_transmission_curve__lever_m = inlined(transmission_curve.lever_m)
_jaw_gravity__jaw_load_N_m = inlined(jaw_gravity.jaw_load_N_m)
_jaw_coupling__jaw_load_N_m = inlined(jaw_coupling.jaw_load_N_m)
_jaw_position_friction__jaw_friction_N_m = inlined(jaw_position_friction.jaw_friction_N_m)
_encoder_eccentricity__encoder_error_rad = inlined(encoder_eccentricity.encoder_error_rad)
_encoder_scale__encoder_error_rad = inlined(encoder_scale.encoder_error_rad)


class Physics(NamedTuple):
    """Numbers of the plant, then every parameter of every effect in the order of the catalogue; SI."""

    r_m: float
    r_j: float
    I_m: float
    I_j: float
    D_m: float
    motor_coulomb: float
    jaw_coulomb: float
    k: float
    K_t: float
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


@inlined
def motor_friction_N_m(p: Physics, omega_m_rad_per_s: float, tension_N: float) -> float:
    """Return the level of the motor's dry friction at a speed, the same in both directions."""
    total = p.motor_coulomb
    total += _stribeck_friction__motor_friction_N_m(
        p.stribeck_friction_rise_N_m, p.stribeck_friction_speed_rad_per_s, omega_m_rad_per_s
    )
    total += _load_dependent_friction__motor_friction_N_m(p.load_dependent_friction_mu, p.r_m, tension_N)
    total += _film_friction__motor_friction_N_m(
        p.film_friction_level_N_m, p.film_friction_speed_rad_per_s, omega_m_rad_per_s
    )
    return total


@inlined
def motor_friction_at_rest_N_m(p: Physics, tension_N: float) -> float:
    """Return the same at standstill."""
    total = p.motor_coulomb
    total += _stribeck_friction__motor_friction_at_rest_N_m(p.stribeck_friction_rise_N_m)
    total += _load_dependent_friction__motor_friction_at_rest_N_m(p.load_dependent_friction_mu, p.r_m, tension_N)
    return total


@inlined
def forward_friction_N_m(p: Physics) -> float:
    """Return by how much more a positive speed of the motor is braked."""
    total = 0.0
    total += _coulomb_asymmetry__forward_friction_N_m(p.coulomb_asymmetry_difference_N_m)
    return total


@inlined
def backward_friction_N_m(p: Physics) -> float:
    """Return by how much more a negative speed of the motor is braked."""
    total = 0.0
    total += _coulomb_asymmetry__backward_friction_N_m(p.coulomb_asymmetry_difference_N_m)
    return total


@inlined
def motor_viscosity_N_m_s_per_rad(p: Physics, time_s: float) -> float:
    """Return D at a time, the mean of both directions."""
    total = p.D_m
    total += _viscous_drift__motor_viscosity_N_m_s_per_rad(
        p.viscous_drift_relative_change, p.viscous_drift_time_constant_s, p.D_m, time_s
    )
    total += _viscous_asymmetry__motor_viscosity_N_m_s_per_rad(p.viscous_asymmetry_difference_N_m_s_per_rad)
    return total


@inlined
def motor_drag_N_m(p: Physics, omega_m_rad_per_s: float) -> float:
    """Return the torque that brakes one direction of the motor more."""
    total = 0.0
    total += _viscous_asymmetry__motor_drag_N_m(p.viscous_asymmetry_difference_N_m_s_per_rad, omega_m_rad_per_s)
    return total


@inlined
def motor_torque_N_m(p: Physics, theta_m_rad: float) -> float:
    """Return the torque on the motor without current."""
    total = 0.0
    total += _cogging__motor_torque_N_m(p.cogging_sine_N_m, p.cogging_cosine_N_m, p.cogging_harmonic, theta_m_rad)
    return total


@inlined
def relative_torque(p: Physics, theta_m_rad: float) -> float:
    """Return the relative change of the motor's torque with its angle."""
    total = 0.0
    total += _torque_ripple__relative_torque(
        p.torque_ripple_sine, p.torque_ripple_cosine, p.torque_ripple_harmonic, theta_m_rad
    )
    return total


@inlined
def relative_torque_constant(p: Physics, time_s: float) -> float:
    """Return the relative change of K_t at a time."""
    total = 0.0
    total += _torque_constant_drift__relative_torque_constant(
        p.torque_constant_drift_relative_change, p.torque_constant_drift_time_constant_s, time_s
    )
    return total


@inlined
def wound_m(p: Physics, theta_p_rad: float) -> float:
    """Return the wire wound up from angle 0 on."""
    total = p.r_m * theta_p_rad
    total += _pulley_eccentricity__wound_m(p.pulley_eccentricity_sine, p.pulley_eccentricity_cosine, p.r_m, theta_p_rad)
    total += _spool_radius_change__wound_m(p.spool_radius_change_pitch_m_per_turn, theta_p_rad)
    return total


@inlined
def radius_m(p: Physics, theta_p_rad: float) -> float:
    """Return the effective radius of the motor pulley."""
    total = p.r_m
    total += _pulley_eccentricity__radius_m(
        p.pulley_eccentricity_sine, p.pulley_eccentricity_cosine, p.r_m, theta_p_rad
    )
    total += _spool_radius_change__radius_m(p.spool_radius_change_pitch_m_per_turn, theta_p_rad)
    return total


@inlined
def paid_m(p: Physics, theta_j_rad: float) -> float:
    """Return the wire that the jaw takes from angle 0 on."""
    total = p.r_j * theta_j_rad
    total += _transmission_curve__paid_m(p.transmission_curve_sine, p.transmission_curve_cosine, p.r_j, theta_j_rad)
    return total


@inlined
def lever_m(p: Physics, theta_j_rad: float) -> float:
    """Return the lever at which the wire pulls the jaw."""
    total = p.r_j
    total += _transmission_curve__lever_m(p.transmission_curve_sine, p.transmission_curve_cosine, p.r_j, theta_j_rad)
    return total


@inlined
def jaw_load_N_m(p: Physics, theta_j_rad: float) -> float:
    """Return the load on the jaw that depends on its angle."""
    total = 0.0
    total += _jaw_gravity__jaw_load_N_m(p.jaw_gravity_sine_N_m, p.jaw_gravity_cosine_N_m, theta_j_rad)
    total += _jaw_coupling__jaw_load_N_m(p.jaw_coupling_stiffness_N_m_per_rad, p.jaw_coupling_torque_N_m, theta_j_rad)
    return total


@inlined
def jaw_friction_N_m(p: Physics, theta_j_rad: float) -> float:
    """Return the level of the jaw's dry friction; below 0 there is none."""
    total = p.jaw_coulomb
    total += _jaw_position_friction__jaw_friction_N_m(
        p.jaw_position_friction_slope_N_m_per_rad, p.jaw_position_friction_curvature_N_m_per_rad2, theta_j_rad
    )
    return total


@inlined
def encoder_rad(p: Physics, theta_m_rad: float) -> float:
    """Return the angle that the encoder shows, before quantisation."""
    total = theta_m_rad
    total += _encoder_eccentricity__encoder_error_rad(
        p.encoder_eccentricity_sine_rad, p.encoder_eccentricity_cosine_rad, theta_m_rad
    )
    total += _encoder_scale__encoder_error_rad(p.encoder_scale_relative_error, theta_m_rad)
    return total


@inlined
def level_changes(p: Physics) -> float:
    """Return 0 where no effect changes the level of dry friction."""
    total = 0.0
    total += abs(p.stribeck_friction_rise_N_m)
    total += abs(p.load_dependent_friction_mu)
    total += abs(p.jaw_position_friction_slope_N_m_per_rad)
    total += abs(p.jaw_position_friction_curvature_N_m_per_rad2)
    total += abs(p.film_friction_level_N_m)
    return total


@inlined
def torque_changes(p: Physics) -> float:
    """Return 0 where no effect changes torques on the motor or the jaw."""
    total = 0.0
    total += abs(p.presliding_friction_level_N_m)
    total += abs(p.viscous_drift_relative_change)
    total += abs(p.jaw_gravity_sine_N_m)
    total += abs(p.jaw_gravity_cosine_N_m)
    total += abs(p.cogging_sine_N_m)
    total += abs(p.cogging_cosine_N_m)
    total += abs(p.torque_ripple_sine)
    total += abs(p.torque_ripple_cosine)
    total += abs(p.jaw_coupling_stiffness_N_m_per_rad)
    total += abs(p.jaw_coupling_torque_N_m)
    total += abs(p.loaded_presliding_mu)
    total += abs(p.viscous_asymmetry_difference_N_m_s_per_rad)
    total += abs(p.jaw_presliding_level_N_m)
    total += abs(p.jaw_presliding_mu)
    return total


@inlined
def wire_changes(p: Physics) -> float:
    """Return 0 where no effect changes the law of the wire or what winds it."""
    total = 0.0
    total += abs(p.wire_slack_half_width_m)
    total += abs(p.wire_hardening_beta_per_m2)
    total += abs(p.wire_hysteresis_force_N)
    total += abs(p.wire_creep_share)
    total += abs(p.wire_permanent_stretch_stretch_m)
    total += abs(p.pulley_eccentricity_sine)
    total += abs(p.pulley_eccentricity_cosine)
    total += abs(p.spool_radius_change_pitch_m_per_turn)
    total += abs(p.transmission_play_half_width_rad)
    total += abs(p.transmission_curve_sine)
    total += abs(p.transmission_curve_cosine)
    return total


@inlined
def without_dry_friction(p: Physics, motor: bool, jaw: bool) -> Physics:
    """Return the plant without what holds its motor, its jaw or both at rest."""
    motor_kept, jaw_kept = 0.0 if motor else 1.0, 0.0 if jaw else 1.0
    return Physics(
        p.r_m,
        p.r_j,
        p.I_m,
        p.I_j,
        p.D_m,
        motor_kept * p.motor_coulomb,
        jaw_kept * p.jaw_coulomb,
        p.k,
        p.K_t,
        motor_kept * p.stribeck_friction_rise_N_m,
        p.stribeck_friction_speed_rad_per_s,
        p.presliding_friction_level_N_m,
        p.presliding_friction_angle_rad,
        motor_kept * p.load_dependent_friction_mu,
        motor_kept * p.coulomb_asymmetry_difference_N_m,
        p.viscous_drift_relative_change,
        p.viscous_drift_time_constant_s,
        jaw_kept * p.jaw_position_friction_slope_N_m_per_rad,
        jaw_kept * p.jaw_position_friction_curvature_N_m_per_rad2,
        p.jaw_gravity_sine_N_m,
        p.jaw_gravity_cosine_N_m,
        p.wire_slack_half_width_m,
        p.wire_hardening_beta_per_m2,
        p.wire_hysteresis_force_N,
        p.wire_hysteresis_stretch_m,
        p.wire_creep_share,
        p.wire_creep_time_constant_s,
        p.wire_damping_damping_N_s_per_m,
        p.wire_permanent_stretch_stretch_m,
        p.torque_constant_drift_relative_change,
        p.torque_constant_drift_time_constant_s,
        p.cogging_sine_N_m,
        p.cogging_cosine_N_m,
        p.cogging_harmonic,
        p.torque_ripple_sine,
        p.torque_ripple_cosine,
        p.torque_ripple_harmonic,
        p.current_offset_offset_A,
        p.current_gain_relative_error,
        p.amplifier_deadband_half_width_A,
        p.electrical_lag_time_constant_s,
        p.actuation_delay_delay_s,
        p.channel_skew_theta_m_s,
        p.channel_skew_current_s,
        p.channel_skew_theta_j_s,
        p.channel_skew_tau_w_s,
        p.encoder_eccentricity_sine_rad,
        p.encoder_eccentricity_cosine_rad,
        p.encoder_scale_relative_error,
        p.pulley_eccentricity_sine,
        p.pulley_eccentricity_cosine,
        p.spool_radius_change_pitch_m_per_turn,
        p.current_saturation_limit_A,
        p.transmission_play_half_width_rad,
        p.transmission_curve_sine,
        p.transmission_curve_cosine,
        p.jaw_coupling_stiffness_N_m_per_rad,
        p.jaw_coupling_torque_N_m,
        p.loaded_presliding_mu,
        p.loaded_presliding_angle_rad,
        p.viscous_asymmetry_difference_N_m_s_per_rad,
        motor_kept * p.film_friction_level_N_m,
        p.film_friction_speed_rad_per_s,
        p.jaw_presliding_level_N_m,
        p.jaw_presliding_mu,
        p.jaw_presliding_angle_rad,
        p.jaw_viscous_friction_viscosity_N_m_s_per_rad,
    )
