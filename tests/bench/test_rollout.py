"""The rollout of the model beside the same equations in C at -O3, and beside MuJoCo's RK4 on the same plant."""

import ctypes
import importlib
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.model import closed_loop, parameters
from hil_forceps.model.closed_loop import Inputs
from hil_forceps.model.composition import Physics, motor_viscosity_N_m_s_per_rad
from hil_forceps.model.current import current_step
from hil_forceps.model.linear.gains import SHORT, SIZE, fill_all
from hil_forceps.rig import load_rig
from hil_forceps.rig.catalogue import effect
from hil_forceps.rig.sections import DriveLaw

Vector = NDArray[np.float64]
RIG = load_rig(Path(__file__).parents[2] / "configs" / "paper.yaml")
SOURCE = Path(__file__).with_name("rollout.c")
LAW = closed_loop.law_vector(
    DriveLaw(
        sample_time_s=1e-3,
        kp_A_per_rad=1.2,
        ki_A_per_rad_s=15.0,
        kd_A_s_per_rad=0.006,
        derivative_cutoff_Hz=150.0,
        current_limit_A=1.0,
    )
)
ROWS, ROW_S = 12_000, 1e-3
SUBSTEPS = 5  # an odd number: what has an effect takes all of them, as C does, and not one step for a sample
REPEATS = 15
MAX_RATIO = 1.5
# What a fit runs most: nothing, a part of the wire, friction, timing; and many at once.
CASES: dict[str, tuple[str, ...]] = {
    "no effect": (),
    "wire": ("wire_hardening", "wire_creep"),
    "friction": ("load_dependent_friction", "coulomb_asymmetry", "presliding_friction"),
    "slack": ("wire_slack",),
    "timing": ("electrical_lag", "actuation_delay"),
    "transmission": ("transmission_play", "transmission_curve", "jaw_coupling", "loaded_presliding"),
    "newest": ("viscous_asymmetry", "film_friction", "jaw_presliding", "jaw_viscous_friction"),
    "ten": (
        "stribeck_friction", "presliding_friction", "load_dependent_friction", "jaw_gravity", "wire_hardening",
        "wire_hysteresis", "wire_creep", "cogging", "torque_ripple", "pulley_eccentricity",
    ),
}  # fmt: skip


class CurrentStep(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_double) for name in ("mean", "slope", "end", "arrival_mean", "arrival_slope", "arrival_end")),
        ("whole", ctypes.c_int),
        ("at", ctypes.c_int),
    ]


def inputs_of() -> Inputs:
    t = np.linspace(0.0, (ROWS - 1) * ROW_S, ROWS)
    reference = 0.6 + 0.4 * np.sin(2.0 * np.pi * 0.7 * t) + 0.1 * np.sin(2.0 * np.pi * 3.1 * t)
    load = 1e-3 * np.sin(2.0 * np.pi * 0.4 * t)
    return Inputs(t, reference, load, np.array([], dtype=np.int64), np.array([]))


def theta_of(effects: tuple[str, ...]) -> Vector:
    theta = parameters.vector(RIG)
    for effect_id in effects:
        for item in effect(effect_id).parameters:
            theta[parameters.index(f"effects.{effect_id}.{item.name}")] = item.typical
    return theta


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return built(tmp_path_factory.mktemp("c"))


def built(folder: Path) -> ctypes.CDLL:
    """Compile the rollout in C."""
    assert shutil.which("gcc"), "gcc is needed to compare with C"
    target = folder / "rollout.so"
    flags = ["-O3", "-std=c11", "-D_GNU_SOURCE", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, "-o", str(target), str(SOURCE), "-lm"], check=True)
    return ctypes.CDLL(str(target))


def in_c(library: ctypes.CDLL, theta: Vector, inputs: Inputs) -> tuple[Callable[[], None], Vector]:
    """Return a call of the C rollout and the (8, n) array that it fills."""
    start = closed_loop.rest(theta, 0.6)
    p = Physics(*theta.tolist())
    step_s = ROW_S / SUBSTEPS
    gains = np.empty((SHORT + 2, SIZE))
    fill_all(gains, p, motor_viscosity_N_m_s_per_rad(p, 0.0), step_s)
    c = current_step(step_s, SUBSTEPS, p.actuation_delay_delay_s, p.electrical_lag_time_constant_s)
    current = CurrentStep(
        c.mean, c.slope, c.end, c.arrival_mean, c.arrival_slope, c.arrival_end, c.whole_samples, c.switch_step
    )
    state = np.array([*start.plant, *start.drive])
    out = np.empty((8, ROWS))
    timing = {
        parameters.index("effects.electrical_lag.time_constant_s"),
        parameters.index("effects.actuation_delay.delay_s"),
    }
    changed = np.flatnonzero(theta != theta_of(())).tolist()
    full = not timing.issuperset(changed)

    def data(values: Vector) -> Any:
        return values.ctypes.data_as(ctypes.c_void_p)

    def call() -> None:
        library.rollout(
            data(theta), data(LAW), ctypes.c_double(0.0), ctypes.c_double(ROW_S), ROWS, data(inputs.reference_rad),
            data(inputs.tau_w_N_m), data(state), SUBSTEPS, 1, data(gains), ctypes.byref(current), int(full), data(out),
        )  # fmt: skip

    return call, out


def tell(text: str) -> None:
    sys.stdout.write(f"\n{text}\n")


def seconds(call: Callable[[], object]) -> float:
    begin = time.thread_time_ns()
    call()
    return (time.thread_time_ns() - begin) * 1e-9


@pytest.mark.parametrize("name", CASES)
def test_rollout_against_the_same_equations_in_c(library: ctypes.CDLL, name: str) -> None:
    theta, inputs = theta_of(CASES[name]), inputs_of()
    start = closed_loop.rest(theta, 0.6)

    def ours() -> closed_loop.Channels:
        return closed_loop.simulate(theta, LAW, 0.0, inputs, start, SUBSTEPS)

    call, _ = in_c(library, theta, inputs)
    call()
    pairs = [(seconds(ours), seconds(call)) for _ in range(REPEATS)]
    python_s, c_s = min(a for a, _ in pairs), min(b for _, b in pairs)
    steps = (ROWS - 1) * SUBSTEPS
    ratio = statistics.median(a / b for a, b in pairs)
    tell(
        f"{name}: {python_s / steps * 1e9:.0f} ns a step, {python_s / (ROWS - 1) * 1e9:.0f} ns a row; "
        f"C {c_s / steps * 1e9:.0f} ns a step; ratio {ratio:.2f}"
    )
    assert ratio <= MAX_RATIO


MUJOCO = """
<mujoco>
  <option timestep="{step}" integrator="RK4" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <body name="motor"><joint name="motor" axis="0 0 1" damping="{D_m}" frictionloss="{F_m}"/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="{I_m} {I_m} {I_m}"/></body>
    <body name="jaw" pos="1 0 0"><joint name="jaw" axis="0 0 1" frictionloss="{F_j}"/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="{I_j} {I_j} {I_j}"/></body>
  </worldbody>
  <tendon><fixed name="wire" stiffness="{k}" springlength="0">
    <joint joint="motor" coef="{r_m}"/><joint joint="jaw" coef="-{r_j}"/></fixed></tendon>
  <actuator><motor joint="motor"/></actuator>
</mujoco>
"""


def test_rollout_beside_mujoco() -> None:
    mujoco: Any = importlib.import_module("mujoco")
    p = RIG.plant()
    model = mujoco.MjModel.from_xml_string(
        MUJOCO.format(
            step=ROW_S / SUBSTEPS, D_m=p.motor_viscous_N_m_s_per_rad, F_m=p.motor_coulomb_N_m,
            I_m=p.motor_inertia_kg_m2,
            F_j=p.jaw_coulomb_N_m, I_j=p.jaw_inertia_kg_m2, k=p.wire_stiffness_N_per_m, r_m=p.motor_pulley_radius_m,
            r_j=p.jaw_pulley_radius_m,
        )
    )  # fmt: skip
    data = mujoco.MjData(model)
    data.ctrl[0] = 1e-3
    steps = 4_000
    mujoco_s = min(seconds(lambda: mujoco.mj_step(model, data, steps)) for _ in range(3))
    theta, inputs = theta_of(()), inputs_of()
    start = closed_loop.rest(theta, 0.6)
    closed_loop.simulate(theta, LAW, 0.0, inputs, start, SUBSTEPS)
    ours_s = min(seconds(lambda: closed_loop.simulate(theta, LAW, 0.0, inputs, start, SUBSTEPS)) for _ in range(5))
    ours_ns, mujoco_ns = ours_s / ((ROWS - 1) * SUBSTEPS) * 1e9, mujoco_s / steps * 1e9
    tell(f"MuJoCo RK4 {mujoco_ns:.0f} ns a step, ours {ours_ns:.0f} ns a step: {mujoco_ns / ours_ns:.0f} times")
    assert mujoco_ns > ours_ns
