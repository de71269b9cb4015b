"""The catalogue of effects: what a rig file may hold under `effects:`, with equations, units and physical ranges.

Plain data. The mind's model and the simulated world implement each entry on their own, from these equations:

    law      i_ref: the drive's law on θ_enc; i_ref → deadband → saturation → delay → lag → i (true current)
    sensors  i_meas = (1 + g) i + i0;  θ_enc = quantised((1 + s) θ_m + A_s sin θ_m + A_c cos θ_m);  a skewed channel is
             recorded as it was T_s earlier (in the log alone, not in the loop)
    motor    I_m ω̇_m = K_t(t) i (1 + ripple(θ_m)) + cogging(θ_m) − D(t, ω_m) ω_m − F_m − r(θ_p) f
    play     θ_p = θ_m − p,  |p| ≤ ψ,  ṗ = ω_m, but 0 where p would leave ±ψ; without play θ_p = θ_m
    wire     x = wound(θ_p) − paid(θ_j),  wound' = r(θ_p),  paid' = r_j(θ_j);  e = x − x0 − x_c;  d = dz(e, δ)
             f = k d (1 + β d²) + c ẋ [where d ≠ 0 or δ = 0] + h z
    jaw      I_j ω̇_j = r_j(θ_j) f − F_j(θ_j) − gravity(θ_j) − coupling(θ_j) − τ_w
    friction F = level · sgn ω while moving; at rest whatever holds, up to the level

Times of drifts count from the first row of a run (in the world: from the start of the load profile or of the run).
"""

import math
from typing import Literal, NamedTuple

Location = Literal["motor", "wire", "jaw", "sensor", "timing"]


class EffectParameter(NamedTuple):
    """A parameter of an effect."""

    name: str
    unit: str  # "" for a pure number
    minimum: float
    maximum: float
    neutral: float | None  # the value that switches the effect off; None: a shape, meaningless while it is off
    typical: float  # a size to begin from: visible, not large
    meaning: str
    plausible: float = math.inf  # the largest that hardware has; what fits beyond only acts like it


class Effect(NamedTuple):
    """An entry of the catalogue."""

    id: str
    location: Location
    summary: str
    equation: str
    parameters: tuple[EffectParameter, ...]
    source: str
    shown_by: str  # what data can show it
    by_angle: bool = False  # depends on where the angle's zero is


_P = EffectParameter


def _time_constant(typical: float) -> EffectParameter:
    return _P("time_constant_s", "s", 1e-2, 1e4, None, typical, "time constant")


def _wave(
    unit: str, limit: float, typical: float, plausible: float = math.inf
) -> tuple[EffectParameter, EffectParameter]:
    suffix = f"_{unit}" if unit else ""
    return (
        _P(f"sine{suffix}", unit, -limit, limit, 0.0, typical, "amplitude of the sine", plausible),
        _P(f"cosine{suffix}", unit, -limit, limit, 0.0, typical, "amplitude of the cosine", plausible),
    )


# Steel cables on steel and in sheaths have μ of 0.05 to 0.3, dry ones up to 0.6; a lubricant is up to four times as
# viscous cold as warm; magnets lose 0.1 % of K_t a kelvin. Cables creep by some percent of their stretch, fibre ropes
# by up to a third. Ripple beyond a fifth, and a radius that is off by more than a tenth, are no sound motor or pulley.
_RUBBING, _WARMING, _MAGNET, _CREEPING, _RIPPLING, _ROUND, _BENT_LEVER = 0.6, 3.0, 0.2, 0.35, 0.2, 0.1, 0.3
_SCALED = 0.1  # a sensor's gain

_HARMONIC = _P("harmonic", "", 1.0, 200.0, None, 6.0, "periods in a turn of the motor pulley")

EFFECTS: tuple[Effect, ...] = (
    Effect(
        "stribeck_friction",
        "motor",
        "friction of the motor higher at low speed",
        "F_m += R exp(−(ω_m/ω_s)²) sgn ω_m",
        (
            _P("rise_N_m", "N_m", 0.0, 1.0, 0.0, 1e-4, "rise above Coulomb friction at standstill, T_s − T_c"),
            _P("speed_rad_per_s", "rad_per_s", 1e-3, 1e3, None, 0.3, "speed over which it falls, ω_s"),
        ),
        "R. Stribeck 1902; Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
        "slow motion at several speeds, both directions",
    ),
    Effect(
        "presliding_friction",
        "motor",
        "micro-slip of the motor's friction before sliding",
        "F_m += L z,  ż = ω_m (1 − z sgn ω_m)/δ",
        (
            _P("level_N_m", "N_m", 0.0, 1.0, 0.0, 1e-4, "friction once it slides, L"),
            _P("angle_rad", "rad", 1e-5, 2.0, None, 0.02, "angle over which it builds up, δ"),
        ),
        "P. R. Dahl, Aerospace Corp. TOR-0158(3107-18)-1, 1968; LuGre: Canudas de Wit et al., IEEE TAC 40(3), 1995",
        "small motions and reversals",
    ),
    Effect(
        "load_dependent_friction",
        "motor",
        "friction that grows with the tension of the wire (pulleys, guides, sheath)",
        "F_m += μ r_m |f| sgn ω_m",
        (_P("mu", "", 0.0, 2.0, 0.0, 0.02, "friction torque over tension times radius, μ", _RUBBING),),
        "capstan law: L. Euler 1769; Kaneko, Yamashita, Tanie, ICAR 1991 (tendon-sheath)",
        "motion in both directions under different loads",
    ),
    Effect(
        "coulomb_asymmetry",
        "motor",
        "friction of the motor differs by direction",
        "F_m += a for ω_m > 0 where a > 0, −|a| for ω_m < 0 where a < 0 (both brake)",
        (_P("difference_N_m", "N_m", -1.0, 1.0, 0.0, 1e-4, "forward less backward friction, a"),),
        "Armstrong-Hélouvry, Control of Machines with Friction, 1991",
        "motion in both directions",
    ),
    Effect(
        "viscous_drift",
        "motor",
        "viscous friction of the motor changes as it warms up",
        "D(t) = D_m (1 + c (1 − exp(−t/T)))",
        (_P("relative_change", "", -0.95, 5.0, 0.0, 0.1, "final change over D_m, c", _WARMING), _time_constant(6.0)),
        "viscosity of a lubricant over temperature: Simoni et al., IROS 2015",
        "the same motion early and late in a run",
    ),
    Effect(
        "jaw_position_friction",
        "jaw",
        "friction of the jaw depends on its angle",
        "F_j level = max(0, τ_Fj + b θ_j + q θ_j²)",
        (
            _P("slope_N_m_per_rad", "N_m_per_rad", -0.1, 0.1, 0.0, 1e-5, "b"),
            _P("curvature_N_m_per_rad2", "N_m_per_rad2", -0.1, 0.1, 0.0, 1e-5, "q"),
        ),
        "Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, position-dependent friction",
        "motion of the jaw over its range, both directions",
        by_angle=True,
    ),
    Effect(
        "jaw_gravity",
        "jaw",
        "the jaw's weight",
        "gravity = m g l cos(θ_j + φ) = G_c cos θ_j + G_s sin θ_j, a load on the jaw",
        _wave("N_m", 0.1, 1e-5),
        "rigid body under gravity",
        "the jaw over a wide range of angles; the forceps in another orientation",
        by_angle=True,
    ),
    Effect(
        "wire_slack",
        "wire",
        "dead zone of the wire around zero tension, both ways (backlash)",
        "d = dz(e, δ)",
        (_P("half_width_m", "m", 0.0, 2e-3, 0.0, 1e-6, "half the dead zone, δ"),),
        "Nordin, Gutman, Automatica 38(10), 2002 (backlash)",
        "tension that changes its sign",
    ),
    Effect(
        "wire_hardening",
        "wire",
        "stiffness grows with stretch",
        "f = k d (1 + β d²)",
        (_P("beta_per_m2", "per_m2", 0.0, 1e13, 0.0, 1e7, "β"),),
        "stranded wire: Costello, Theory of Wire Rope, 1997; cubic spring of Duffing",
        "several levels of load",
    ),
    Effect(
        "wire_hysteresis",
        "wire",
        "rate-independent loop of tension over stretch",
        "f += h z,  ż = ẋ (1 − z sgn ẋ)/s",
        (
            _P("force_N", "N", 0.0, 100.0, 0.0, 0.02, "half height of the loop, h"),
            _P("stretch_m", "m", 1e-8, 2e-3, None, 5e-6, "stretch over which it builds up, s"),
        ),
        "Bouc 1967, Wen 1976 (A = 1, β = γ, n = 1), the same as Dahl 1968 over stretch",
        "load that rises and falls again",
    ),
    Effect(
        "wire_creep",
        "wire",
        "slow visco-elastic stretch under load that recovers",
        "ẋ_c = (s f/k − x_c)/T",
        (
            _P("share", "", 0.0, 5.0, 0.0, 0.02, "slow stretch over elastic stretch in the end, s", _CREEPING),
            _time_constant(2.0),
        ),
        "standard linear solid: C. Zener 1948",
        "a load held for longer than the time constant, and released",
    ),
    Effect(
        "wire_damping",
        "wire",
        "viscous damping of the wire",
        "f += c ẋ",
        (_P("damping_N_s_per_m", "N_s_per_m", 0.0, 1e3, 0.0, 0.3, "c"),),
        "Kelvin-Voigt solid",
        "fast motion, steps of the load",
    ),
    Effect(
        "wire_permanent_stretch",
        "wire",
        "the zero of the wire has moved",
        "e = x − x0",
        (_P("stretch_m", "m", -5e-3, 5e-3, 0.0, 1e-6, "x0"),),
        "plastic stretch of a wire (constructional stretch): Costello 1997",
        "the jaw's angle against the motor's without load",
    ),
    Effect(
        "torque_constant_drift",
        "motor",
        "the torque constant changes as the motor warms",
        "K_t(t) = K_t (1 + c (1 − exp(−t/T)))",
        (_P("relative_change", "", -0.9, 1.0, 0.0, -0.02, "final change over K_t, c", _MAGNET), _time_constant(6.0)),
        "temperature coefficient of magnets: Sebastian, IEEE TIA 31(2), 1995",
        "the same load early and late in a run",
    ),
    Effect(
        "cogging",
        "motor",
        "torque periodic in the motor's angle, without current",
        "cogging = S sin(h θ_m) + C cos(h θ_m)",
        (*_wave("N_m", 1.0, 1e-4), _HARMONIC),
        "Hanselman, Brushless Permanent Magnet Motor Design, 2003",
        "slow motion over several periods",
        by_angle=True,
    ),
    Effect(
        "torque_ripple",
        "motor",
        "torque periodic in the motor's angle, in proportion to the current",
        "ripple = S sin(h θ_m) + C cos(h θ_m)",
        (*_wave("", 0.9, 0.02, _RIPPLING), _HARMONIC),
        "Jahns, Soong, IEEE TIE 43(2), 1996",
        "motion over several periods under load",
        by_angle=True,
    ),
    Effect(
        "current_offset",
        "sensor",
        "offset of the current sensor",
        "i_meas = i + i0",
        (_P("offset_A", "A", -10.0, 10.0, 0.0, 5e-3, "i0"),),
        "sensor calibration",
        "the drive's law, or motion in both directions",
    ),
    Effect(
        "current_gain",
        "sensor",
        "gain of the current sensor",
        "i_meas = (1 + g) i",
        (_P("relative_error", "", -0.9, 2.0, 0.0, 0.02, "g", _SCALED),),
        "sensor calibration",
        "the drive's law; without it this can't be told from K_t",
    ),
    Effect(
        "amplifier_deadband",
        "motor",
        "small commands give no current",
        "i = dz(i_ref, w)",
        (_P("half_width_A", "A", 0.0, 5.0, 0.0, 3e-3, "w"),),
        "dead time of a bridge: Jeong, Park, IEEE TIE 38(2), 1991",
        "commands that change their sign",
    ),
    Effect(
        "electrical_lag",
        "timing",
        "the current lags its reference",
        "di/dt = (i_ref − i)/T",
        (_P("time_constant_s", "s", 0.0, 0.1, 0.0, 2e-4, "L/R or the current loop's, T"),),
        "armature circuit of a motor",
        "fast changes of the current",
    ),
    Effect(
        "actuation_delay",
        "timing",
        "dead time from command to current",
        "i(t) = i_ref(t − T_d)",
        (_P("delay_s", "s", 0.0, 0.1, 0.0, 5e-4, "T_d"),),
        "computation and communication delay",
        "fast changes of the current",
    ),
    Effect(
        "channel_skew",
        "timing",
        "a channel is stamped late against the others",
        "recorded(t) = true(t − T_s)",
        (
            _P("theta_m_s", "s", -0.1, 0.1, 0.0, 1e-3, "of theta_m_rad"),
            _P("current_s", "s", -0.1, 0.1, 0.0, 1e-3, "of current_A (or tau_m_N_m)"),
            _P("theta_j_s", "s", -0.1, 0.1, 0.0, 1e-3, "of theta_j_rad"),
            _P("tau_w_s", "s", -0.1, 0.1, 0.0, 1e-3, "of tau_w_N_m"),
        ),
        "data acquisition on more than one clock",
        "fast changes of two channels that belong together",
    ),
    Effect(
        "encoder_eccentricity",
        "sensor",
        "angle error of the encoder once per turn",
        "θ_enc = θ_m + A_s sin θ_m + A_c cos θ_m",
        _wave("rad", 0.5, 2e-3),
        "mounting error of an encoder disc",
        "several turns of the motor, or a jaw sensor",
        by_angle=True,
    ),
    Effect(
        "encoder_scale",
        "sensor",
        "scale error of the encoder",
        "θ_enc = (1 + s) θ_m",
        (_P("relative_error", "", -0.5, 0.5, 0.0, 2e-3, "s", _SCALED),),
        "sensor calibration",
        "a jaw sensor and known radii",
    ),
    Effect(
        "pulley_eccentricity",
        "wire",
        "the effective radius of the motor pulley varies round it",
        "r(θ_m) = r_m (1 + E_c cos θ_m + E_s sin θ_m)",
        _wave("", 0.5, 0.01, _ROUND),
        "mounting error of a pulley",
        "a jaw sensor, motion over a good part of a turn",
        by_angle=True,
    ),
    Effect(
        "spool_radius_change",
        "wire",
        "the radius grows with the turns wound up",
        "r(θ_m) = r_m + p θ_m/2π",
        (_P("pitch_m_per_turn", "m_per_turn", -5e-3, 5e-3, 0.0, 2e-5, "p"),),
        "wire wound on itself",
        "a jaw sensor, motion over a good part of a turn",
        by_angle=True,
    ),
    Effect(
        "current_saturation",
        "motor",
        "the current is limited below the limit configured",
        "i = clip(i_ref, ±limit)",
        (_P("limit_A", "A", 0.0, 200.0, None, 0.2, "the limit that acts"),),
        "supply voltage, thermal protection",
        "commands above the limit",
    ),
    Effect(
        "transmission_play",
        "motor",
        "lost motion behind the motor's encoder at each reversal, held by friction: play of a gear, slack guides",
        "θ_p = θ_m − p,  ṗ = ω_m within |p| ≤ ψ (play operator); the wire is wound by θ_p, its pull reaches the motor",
        # What nothing holds in its gap is a dead zone of tension, `wire_slack` with δ = r_m ψ: no sensor tells those.
        (_P("half_width_rad", "rad", 0.0, 0.5, 0.0, 2e-3, "half the lost motion at the motor pulley, ψ"),),
        "Krasnosel'skii, Pokrovskii, Systems with Hysteresis, 1989 (play); Nordin, Gutman, Automatica 38(10), 2002",
        "reversals under tension that keeps its sign, and a jaw sensor",
    ),
    Effect(
        "transmission_curve",
        "jaw",
        "the ratio depends on the jaw's angle: the wire pulls at a lever or an uneven pulley",
        "r_j(θ_j) = r_j (1 + E_c cos θ_j + E_s sin θ_j)",
        _wave("", 0.5, 0.01, _BENT_LEVER),
        "lever arm l cos(θ − φ) of a wire at a lever; mounting error of a pulley",
        "a jaw sensor, motion over its range, several loads",
        by_angle=True,
    ),
    Effect(
        "jaw_coupling",
        "jaw",
        "spring between the jaw and what it is coupled to at rest: the other jaw, its wire, the wrist",
        "coupling = k_c θ_j + τ_c, a load on the jaw",
        (
            _P("stiffness_N_m_per_rad", "N_m_per_rad", 0.0, 0.1, 0.0, 2e-5, "stiffness, k_c"),
            _P("torque_N_m", "N_m", -0.1, 0.1, 0.0, 1e-5, "torque at angle zero, τ_c"),
        ),
        "coupled tendon-driven joints: Tsai, Robot Analysis, 1999 (chapter 10); Hooke's law",
        "the jaw over a wide range of angles, at one load",
        by_angle=True,
    ),
    Effect(
        "loaded_presliding",
        "motor",
        "friction that grows with the tension of the wire and builds up over a way",
        "F_m += μ r_m |f| z,  ż = ω_m (1 − z sgn ω_m)/δ",
        (
            _P("mu", "", 0.0, 2.0, 0.0, 0.02, "friction torque over tension times radius once it slides, μ", _RUBBING),
            _P("angle_rad", "rad", 1e-5, 2.0, None, 0.02, "angle over which it builds up, δ"),
        ),
        "sheath as a chain of Dahl elements: Palli, Melchiorri, ICRA 2006; Do et al., Mechatronics 24(1), 2014",
        "reversals under different loads",
    ),
    Effect(
        "viscous_asymmetry",
        "motor",
        "viscous friction of the motor differs by direction",
        "D += v for ω_m > 0 where v > 0, |v| for ω_m < 0 where v < 0 (both brake)",
        (_P("difference_N_m_s_per_rad", "N_m_s_per_rad", -10.0, 10.0, 0.0, 2e-5, "forward less backward, v"),),
        "Armstrong-Hélouvry, Control of Machines with Friction, 1991; Janot, Gautier, Brunot, EMPS, 2019",
        "motion at several speeds in both directions",
    ),
    Effect(
        "film_friction",
        "motor",
        "friction of the motor that a film of grease gives way to near standstill, where it flows",
        "F_m += L (1 − exp(−|ω_m|/ω_f)) sgn ω_m",
        (
            _P("level_N_m", "N_m", 0.0, 1.0, 0.0, 3e-5, "friction at speed, L"),
            _P("speed_rad_per_s", "rad_per_s", 1e-3, 1e3, None, 0.3, "speed over which it builds up, ω_f"),
        ),
        "yield stress of a grease, regularised: T. C. Papanastasiou, Journal of Rheology 31(5), 1987",
        "slow motion at several speeds, both directions",
    ),
    Effect(
        "jaw_presliding",
        "jaw",
        "friction at the jaw that builds up over a way, partly with the tension of the wire (pin, guides)",
        "F_j += (L + μ r_j |f|) z,  ż = ω_j (1 − z sgn ω_j)/δ",
        (
            _P("level_N_m", "N_m", 0.0, 0.1, 0.0, 1e-5, "friction without tension once it slides, L"),
            _P("mu", "", 0.0, 0.9, 0.0, 0.02, "friction torque over tension times radius once it slides, μ", _RUBBING),
            _P("angle_rad", "rad", 1e-5, 2.0, None, 0.02, "angle over which it builds up, δ"),
        ),
        "P. R. Dahl 1968; sheath as a chain of such elements: Palli, Melchiorri, ICRA 2006",
        "reversals of the jaw under different loads, and a jaw sensor",
    ),
    Effect(
        "jaw_viscous_friction",
        "jaw",
        "viscous friction at the jaw: its bearing, guides and seals",
        "F_j += D_j ω_j",
        (_P("viscosity_N_m_s_per_rad", "N_m_s_per_rad", 0.0, 10.0, 0.0, 1e-5, "viscous friction of the jaw, D_j"),),
        "joint damping of every multibody program; Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, 2006",
        "fast motion of the jaw and a jaw sensor; a motor's viscous friction does not stretch the wire",
    ),
)

EFFECT_IDS = tuple(effect.id for effect in EFFECTS)


def effect(effect_id: str) -> Effect:
    """Return an entry of the catalogue; KeyError for an id that isn't in it."""
    for entry in EFFECTS:
        if entry.id == effect_id:
            return entry
    raise KeyError(effect_id)
