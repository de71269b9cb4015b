"""A second world, which nobody here wrote: MuJoCo carries the forceps, its own parameters hide the effects.

Hinges for motor and jaw, a fixed tendon for the wire, MuJoCo's constraint for dry friction. Around it the drive's law
as docs/rig-file.md has it, counts of the encoder and white noise of the sensors. RK4 at `STEP_S`:
`test_mujoco_world.py` shows that half the step changes no row by what a sensor could tell.
"""

import importlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.rig import Rig
from tests.hidden_effects.generator_scenarios import Scenario, course_of
from virtual_bus.effects.physics import Environment

Vector = NDArray[np.float64]

STEP_S = 5.0e-5
LEAD_S = 0.5  # before the first row: what the start leaves dies away
LEVER_M = 1.0e-3  # of the jaw's weight
GRAVITY_M_PER_S2 = 9.81

MODEL = """
<mujoco>
  <option timestep="{step}" integrator="RK4" gravity="0 -{g} 0"/>
  <worldbody>
    <body name="motor"><joint name="motor" axis="0 0 1" damping="{D_m}" {friction_m}/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="{I_m} {I_m} {I_m}"/></body>
    <body name="jaw" pos="1 0 0">
      <joint name="jaw" axis="0 0 1" damping="{D_j}" stiffness="{k_j}" springref="{rest_deg}" {friction_j}/>
      <inertial pos="{lever} 0 0" mass="{mass}" diaginertia="{I_j} {I_j} {I_j}"/></body>
  </worldbody>
  <tendon><fixed name="wire" stiffness="{k}" damping="{c}" springlength="-{slack} {slack}">
    <joint joint="motor" coef="{r_m}"/><joint joint="jaw" coef="-{r_j}"/></fixed></tendon>
  <actuator>{actuator}<motor joint="jaw"/></actuator>
</mujoco>
"""
MOTOR = '<general joint="motor" gear="{K_t}"/>'
LAGGING_MOTOR = '<general joint="motor" gear="{K_t}" dyntype="filter" dynprm="{lag}"/>'
# Friction as stiff a constraint as the step allows: MuJoCo's own dry friction creeps at rest.
FRICTION = 'frictionloss="{level}" solreffriction="{time} 1" solimpfriction="0.999 0.9999 0.001"'


@dataclass(frozen=True, slots=True)
class Hidden:
    """What MuJoCo's parameters hide, in terms of the catalogue."""

    effect_id: str
    values: Mapping[str, float]

    def of(self, effect_id: str, name: str) -> float:
        """Return a parameter, 0 where another effect is hidden."""
        return self.values[name] if self.effect_id == effect_id else 0.0


NOTHING = Hidden("", {})


def mujoco_run(
    rig: Rig, scenario: Scenario, seed: int, hidden: Hidden = NOTHING, name: str = "", step_s: float = STEP_S
) -> Run:
    """Simulate a run of MuJoCo's forceps in closed loop and return what the drive and the sensors say of it."""
    law = rig.require_drive()
    course = course_of(scenario, seed)
    period_s, steps = law.sample_time_s, round(law.sample_time_s / step_s)
    lead, rows = round(LEAD_S / period_s), round(scenario.duration_s / period_s)
    time_s = np.arange(-lead, rows) * period_s
    reference = course.reference(np.asarray(time_s if scenario.mid_motion else np.maximum(time_s, 0.0)))
    middles_s = -lead * period_s + (np.arange((lead + rows) * steps) + 0.5) * step_s
    load = np.interp(middles_s, course.load.time_ns * 1e-9, course.load.torque_N_m)
    loads = np.interp(time_s, course.load.time_ns * 1e-9, course.load.torque_N_m)
    world = _World(rig, hidden, step_s, float(reference[0]), float(load[0]))
    delay = hidden.of("actuation_delay", "delay_s") / step_s
    commands = np.zeros((lead + rows) * steps + math.ceil(delay) + steps)
    drive = _Drive(rig, world.count(world.motor_rad))
    out = np.empty((4, lead + rows))
    for k in range(lead + rows):
        shown = world.count(world.motor_rad)
        out[:, k] = shown, world.current_A, world.jaw_rad, loads[k] + touched_N_m(course.environment, world.jaw_rad)
        first = k * steps + round(delay)
        commands[first : first + steps] = drive.command_A(float(reference[k]), shown)
        for step in range(k * steps, (k + 1) * steps):
            world.step(float(commands[step]), float(load[step]) + touched_N_m(course.environment, world.jaw_rad))
    theta_m, current, theta_j, tau_w = out[:, lead:]
    noise = np.random.default_rng([seed, 0x4D4A]).standard_normal((3, rows))
    columns = {
        "time_s": np.arange(rows) * period_s,
        "theta_m_ref_rad": reference[lead:],
        "theta_m_rad": theta_m,
        "current_A": current + rig.noise.current_A * noise[0],
        "theta_j_rad": theta_j + rig.noise.theta_j_rad * noise[1],
        "tau_w_N_m": tau_w + rig.noise.tau_w_N_m * noise[2],
    }
    return Run(name or f"{scenario.kind}_{seed}", columns)


def touched_N_m(environment: Environment, jaw_rad: float) -> float:
    """Return the torque of the spring that the jaw touches."""
    return environment.stiffness_N_m_per_rad * max(0.0, jaw_rad - environment.angle_rad)


class _World:
    def __init__(self, rig: Rig, hidden: Hidden, step_s: float, motor_rad: float, load_N_m: float) -> None:
        mujoco: Any = importlib.import_module("mujoco")
        p = rig.plant()
        counts = rig.encoder.counts_per_rev
        self.quantum_rad = 0.0 if counts is None else 2.0 * math.pi / counts
        lag_s = hidden.of("electrical_lag", "time_constant_s")
        weight_N_m = hidden.of("jaw_gravity", "cosine_N_m")
        mass_kg = max(weight_N_m / (GRAVITY_M_PER_S2 * LEVER_M), 1e-6)
        stiffness = hidden.of("jaw_coupling", "stiffness_N_m_per_rad")
        rest_rad = -hidden.of("jaw_coupling", "torque_N_m") / stiffness if stiffness else 0.0
        self.model = mujoco.MjModel.from_xml_string(
            MODEL.format(
                step=step_s, g=GRAVITY_M_PER_S2, lever=LEVER_M if weight_N_m else 0.0, mass=mass_kg,
                D_m=p.motor_viscous_N_m_s_per_rad, I_m=p.motor_inertia_kg_m2,
                I_j=p.jaw_inertia_kg_m2 - (mass_kg * LEVER_M**2 if weight_N_m else 0.0),
                D_j=hidden.of("jaw_viscous_friction", "viscosity_N_m_s_per_rad"),
                k_j=stiffness, rest_deg=math.degrees(rest_rad),
                friction_m=_friction(p.motor_coulomb_N_m, step_s), friction_j=_friction(p.jaw_coulomb_N_m, step_s),
                k=p.wire_stiffness_N_per_m, c=hidden.of("wire_damping", "damping_N_s_per_m"),
                slack=hidden.of("wire_slack", "half_width_m"),
                r_m=p.motor_pulley_radius_m, r_j=p.jaw_pulley_radius_m,
                actuator=(LAGGING_MOTOR if lag_s else MOTOR).format(K_t=p.torque_constant_N_m_per_A, lag=lag_s),
            )
        )  # fmt: skip
        self.data, self.lags, self._step = mujoco.MjData(self.model), bool(lag_s), mujoco.mj_step
        stretch = load_N_m / (p.jaw_pulley_radius_m**2 * p.wire_stiffness_N_per_m)
        self.data.qpos[:] = motor_rad, motor_rad * p.motor_pulley_radius_m / p.jaw_pulley_radius_m - stretch

    @property
    def motor_rad(self) -> float:
        return float(self.data.qpos[0])

    @property
    def jaw_rad(self) -> float:
        return float(self.data.qpos[1])

    @property
    def current_A(self) -> float:
        return float(self.data.act[0] if self.lags else self.data.ctrl[0])

    def count(self, angle_rad: float) -> float:
        return self.quantum_rad * round(angle_rad / self.quantum_rad) if self.quantum_rad else angle_rad

    def step(self, command_A: float, load_N_m: float) -> None:
        self.data.ctrl[0], self.data.ctrl[1] = command_A, -load_N_m
        self._step(self.model, self.data)


def _friction(level_N_m: float, step_s: float) -> str:
    return FRICTION.format(level=level_N_m, time=2.0 * step_s) if level_N_m > 1e-6 else ""


class _Drive:
    """PID or cascade on the encoder's angle, the speed measured through a one-pole filter."""

    def __init__(self, rig: Rig, shown_rad: float) -> None:
        self.law = rig.require_drive()
        self.integral_rad_s, self.speed, self.before = 0.0, 0.0, shown_rad
        self.gain = -math.expm1(-2.0 * math.pi * self.law.derivative_cutoff_Hz * self.law.sample_time_s)

    def command_A(self, reference_rad: float, shown_rad: float) -> float:
        law = self.law
        error = reference_rad - shown_rad
        self.speed += self.gain * ((shown_rad - self.before) / law.sample_time_s - self.speed)
        self.before = shown_rad
        self.integral_rad_s += (error - law.cascade_time_s * self.speed) * law.sample_time_s
        command = law.kp_A_per_rad * error + law.ki_A_per_rad_s * self.integral_rad_s - law.kd_A_s_per_rad * self.speed
        return float(min(max(command, -law.current_limit_A), law.current_limit_A))
