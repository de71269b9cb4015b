"""What a drive's protocol costs: simulation 2 of the paper through every profile, against the truth of the world.

python -m tools.drives.drive_costs [--out DIR]: prints a table and writes it to DIR/drive-costs.md, with a figure. The
forceps, the encoder (but for a Dynamixel's), the noise and the drive's position loop are the same behind each. A sample
is held against what the world was at the instant when it came to the host, so the time that it took counts as an error.
"""

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from firmware_protocol.frames import Frame
from hil_forceps.bench.assembly import Settings
from hil_forceps.bench.metrics import ERROR_WINDOW_S, STEADY_WINDOW_S
from hil_forceps.bench.session import Plan, run_session, service_config, stamps_are_host_time
from hil_forceps.bridge.clocks import VirtualClock
from hil_forceps.bridge.links.adapters import Connection
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.data.readers.bus_logs.frames import read_frames
from hil_forceps.data.recording.reader import read_recording
from hil_forceps.drives.registry import machine_for, sample_period_s
from hil_forceps.report.style import house_style
from hil_forceps.rig import Rig, load_rig
from tools.drives import drive_rates
from virtual_bus.bus.bit_timing import BitTiming, frame_bits
from virtual_bus.bus.half_duplex import BITS_PER_BYTE
from virtual_bus.drives.registry import SERIAL_LINES
from virtual_bus.interface import VirtualForcepsBus

CONFIGS = Path(__file__).parents[2] / "configs"
RIGS = {
    "native": CONFIGS / "realistic.yaml",
    "odrive": CONFIGS / "drives" / "odrive.yaml",
    "cia402": CONFIGS / "drives" / "cia402.yaml",
    "mit": CONFIGS / "drives" / "mit.yaml",
    "moteus": CONFIGS / "drives" / "moteus.yaml",
    "dynamixel": CONFIGS / "drives" / "dynamixel.yaml",
    "vesc": CONFIGS / "drives" / "vesc.yaml",
}
SIMULATION, SEED, DURATION_S = 2, 1, 20.0
STEADY_S = STEADY_WINDOW_S[SIMULATION]
BAND_mN_m = 0.08  # of the errors that are drawn
SHOWN_S = (12.49, 12.53)  # an edge of a pulse of load
OPERATIONAL = 2


class Cost(NamedTuple):
    """What one profile makes of the simulation."""

    time_s: NDArray[np.float64]
    torque_N_m: NDArray[np.float64]
    estimate_N_m: NDArray[np.float64]
    jaw_error_rad: NDArray[np.float64]
    age_us: float | None
    bits_per_s: float
    bus_share: float
    computed_Hz: float  # the largest rate of the host's loop, by `tools.drives.drive_rates`
    tried_Hz: float | None


def run(name: str, out: Path) -> Cost:
    """Run one profile; leaves its recording and its bus log in `out`."""
    rig = load_rig(RIGS[name])
    bus = VirtualForcepsBus(
        f"costs-{name}", rig=rig, simulation=SIMULATION, seed=SEED, truth_duration_s=DURATION_S + 5.0
    )
    settings = Settings("kalman", True, sample_period_s(rig), PAPER_TRAJECTORY, stamps_are_host_time(rig))
    recording, log = out / f"{name}.mcap", out / f"{name}.log"
    plan = Plan(rig, settings, machine_for(rig), service_config(rig, DURATION_S), recording, log, {})
    session = run_session(Connection(VirtualTimeLink(bus), VirtualClock(bus), True, ()), plan)
    if not session.service.ok or session.failures:
        raise SystemExit(f"drive_costs: {name}: {session.service.message} {session.failures}")
    truth, samples = bus.truth_log().columns(), read_recording(recording).samples
    rows = np.searchsorted(truth["bus_time_ns"], samples["received_ns"], side="right") - 1
    operational = samples["state"] == OPERATIONAL
    time_s = (samples["stamp_ns"] - samples["stamp_ns"][operational][0]) * 1e-9
    shown = operational & (time_s >= ERROR_WINDOW_S[0]) & (time_s <= ERROR_WINDOW_S[1])
    reference_rad = np.array([PAPER_TRAJECTORY(t) for t in time_s[shown]])
    frames = list(read_frames(log))
    bits, busy_s = _line_use(rig, [each.frame for each in frames])
    logged_s = ((frames[-1].time_ns or 0) - (frames[0].time_ns or 0)) * 1e-9
    return Cost(
        time_s[shown],
        truth["tau_w_N_m"][rows][shown],
        samples["tau_w_estimate_N_m"][shown],
        truth["theta_j_rad"][rows][shown] - reference_rad,
        session.service.timing["age"]["p50_us"],
        bits / logged_s,
        busy_s / logged_s,
        drive_rates.computed_Hz(rig),
        drive_rates.tried_Hz(rig),
    )


def _line_use(rig: Rig, frames: list[Frame]) -> tuple[int, float]:
    """Return how many bits the frames took on their line, and for how long they held it."""
    codec = SERIAL_LINES.get(rig.drive_profile)
    if codec is None or rig.motor_driver is None:
        timing = BitTiming(rig.bench.bitrate_bit_per_s, rig.bench.data_bitrate_bit_per_s)
        return sum(sum(frame_bits(each)) for each in frames), sum(timing.frame_ns(each) for each in frames) * 1e-9
    bits = BITS_PER_BYTE * sum(len(codec.encode(frame)) for frame in frames)
    return bits, bits / rig.motor_driver.baudrate_bit_per_s


def table(costs: dict[str, Cost]) -> list[str]:
    """Return the table, as markdown."""
    lines = [
        (
            "| profile | τ̂_w RMSE, mN m | largest, mN m | steady jaw error, deg | sample age, ms | kbit/s | of the bus "
            "| largest rate by its bits, Hz | tried, Hz |"
        ),
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, cost in costs.items():
        error_N_m = cost.estimate_N_m - cost.torque_N_m
        steady = (cost.time_s >= STEADY_S[0]) & (cost.time_s <= STEADY_S[1])
        cells = (
            name,
            f"{1e3 * np.sqrt(np.mean(error_N_m**2)):.3f}",
            f"{1e3 * np.max(np.abs(error_N_m)):.2f}",
            f"{np.degrees(np.mean(cost.jaw_error_rad[steady])):.3f}",
            f"{(cost.age_us or 0.0) * 1e-3:.2f}",
            f"{cost.bits_per_s * 1e-3:.0f}",
            f"{100.0 * cost.bus_share:.0f} %",
            f"{cost.computed_Hz:.0f}",
            "none" if cost.tried_Hz is None else f"{cost.tried_Hz:.0f}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def figure(costs: dict[str, Cost]) -> Figure:
    """Draw an edge of the load through each profile, and the error over the whole window."""
    with house_style():
        return _drawn(costs)


def _drawn(costs: dict[str, Cost]) -> Figure:
    drawn = Figure(figsize=(9.0, 8.0), layout="constrained")
    edge, error = drawn.subplots(2, 1, height_ratios=(2, 3))
    for place, (name, cost) in enumerate(costs.items()):
        near = (cost.time_s >= SHOWN_S[0]) & (cost.time_s <= SHOWN_S[1])
        if name == "native":
            edge.plot(cost.time_s[near], 1e3 * cost.torque_N_m[near], "k", label="true")
        edge.plot(cost.time_s[near], 1e3 * cost.estimate_N_m[near], label=name)
        between = np.clip(1e3 * (cost.estimate_N_m - cost.torque_N_m), -BAND_mN_m, BAND_mN_m)
        error.plot(cost.time_s, between - 2.0 * BAND_mN_m * place, linewidth=0.4)
        error.axhline(-2.0 * BAND_mN_m * place, color="k", linewidth=0.5)
    edge.set(ylabel="τ_w, mN m", xlabel="time, s")
    error.set(xlabel="time, s", ylabel=f"τ̂_w − τ_w, a band of ±{BAND_mN_m:g} mN m each")
    error.set_yticks([-2.0 * BAND_mN_m * place for place in range(len(costs))], list(costs))
    error.set_title("between the edges of the load, whose errors are cut off")
    edge.legend(loc="best")
    return drawn


def main() -> int:
    """Run, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=Path("out/drive-costs"))
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    costs = {}
    for name in RIGS:
        sys.stderr.write(f"{name} ...\n")
        costs[name] = run(name, out)
    lines = table(costs)
    (out / "drive-costs.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    figure(costs).savefig(out / "drive-costs.png", dpi=120)
    sys.stdout.write("\n".join([*lines, f"results are in {out}/", ""]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
