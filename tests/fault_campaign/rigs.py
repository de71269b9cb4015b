"""What the campaign runs: a rig for each protocol, with limits that the motion reaches, and the motion itself."""

import math
from functools import cache
from pathlib import Path
from random import Random
from typing import Final

from hil_forceps.control.trajectories import PAPER_START_RAD, Trajectory
from hil_forceps.rig import Rig, load_rig

CONFIGS: Final = Path(__file__).parents[2] / "configs"
PROFILES: Final = ("native", "native_fd", "odrive", "cia402", "moteus", "mit", "mit_damiao", "dynamixel", "vesc")

RUN_NS: Final = 220_000_000  # from the zero on: a motion from bound to bound at the highest speed, and time to spare
# A fault begins before this: by then a run without faults has ended. Mostly what its set-up takes.
HORIZON_NS: Final[dict[str, int]] = {
    "native": 270_000_000,
    "native_fd": 270_000_000,
    "odrive": 620_000_000,
    "cia402": 270_000_000,
    "moteus": 260_000_000,
    "mit": 270_000_000,
    "mit_damiao": 270_000_000,
    "dynamixel": 270_000_000,
    "vesc": 370_000_000,
}

# The motor starts at 1.0996 rad, where the paper's jaw does. Narrow and slow, so that the gate has work in every run.
LIMITS: Final = {
    "limits.position_min_rad": 0.75,
    "limits.position_max_rad": 1.35,
    "limits.speed_max_rad_per_s": 8.0,
    "limits.acceleration_max_rad_per_s2": 1500.0,
}
_JAW_PER_MOTOR: Final = 2.0e-3 / 1.4e-3  # of the paper's pulleys


@cache
def rig_of(profile: str) -> Rig:
    """Return the rig of a protocol."""
    if profile in {"native", "native_fd"}:
        rig = load_rig(CONFIGS / "realistic.yaml")
        transport = "fd" if profile == "native_fd" else "classic"
        return rig.with_changes({**LIMITS, "bench.transport": transport})
    if profile == "mit_damiao":
        changes = {**LIMITS, "motor_driver.mit_variant": "damiao", "motor_driver.reply_id": 0x15}
        return load_rig(CONFIGS / "drives" / "mit.yaml").with_changes(changes)
    return load_rig(CONFIGS / "drives" / f"{profile}.yaml").with_changes(LIMITS)


def trajectory_of(seed: int) -> Trajectory:
    """Return a motion of the jaw, drawn: steps that only the gate makes fit to be followed, beyond the bounds too."""
    source = Random(f"trajectory {seed}")
    time_s, angle_rad = 0.0, PAPER_START_RAD + source.choice((0.0, 0.0, 0.02, -0.03))  # where not 0: an approach
    times, angles = [time_s], [angle_rad]
    for _ in range(source.randint(2, 6)):
        hold_s, way_s = source.uniform(0.005, 0.05), source.choice((1e-6, 0.01, 0.04))
        times += [time_s + hold_s, time_s + hold_s + way_s]
        angles += [angle_rad, angle_rad := source.uniform(0.6, 1.5) * _JAW_PER_MOTOR]
        time_s += hold_s + way_s
    return Trajectory(tuple(times), tuple(angles))


def quantum_rad(rig: Rig) -> float:
    """Return the coarsest step in which a reference or an angle of a rig's drive comes."""
    counts = rig.encoder.counts_per_rev or 1 << 24
    step = 2.0 * math.pi / counts
    settings = rig.motor_driver
    if settings is None:
        return step
    if settings.profile == "dynamixel":
        step = max(step, 2.0 * math.pi / 4096.0)
    if settings.profile == "mit":
        step = max(step, 2.0 * (settings.position_range_rad or 0.0) / 65535.0)
    return step / abs(settings.encoder_rev_per_pulley_rev)
