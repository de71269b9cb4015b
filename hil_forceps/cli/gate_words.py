"""What the gate did in a run, in lines for people and as plain data for `run.json`."""

from collections.abc import Mapping
from typing import Any

from hil_forceps.bridge.gate_tally import GateCount
from hil_forceps.bridge.results import ServiceResult
from hil_forceps.control.gate import GateVerdict

_WORDS = {
    GateVerdict.LIMITED_POSITION: (
        "limited {} (position)",
        "the trajectory, or what compensates the wire, asks for more than limits.position_min_rad and position_max_rad",
    ),
    GateVerdict.LIMITED_SPEED: (
        "limited {} (speed)",
        "the trajectory, or what compensates the wire, asks for more than limits.speed_max_rad_per_s",
    ),
    GateVerdict.LIMITED_ACCELERATION: (
        "limited {} (acceleration)",
        "behind a step of the load or a corner of the trajectory that is usual; limits.acceleration_max_rad_per_s2",
    ),
    GateVerdict.LIMITED_JERK: (
        "limited {} (jerk)",
        "behind a step of the load or a corner of the trajectory that is usual; limits.jerk_max_rad_per_s3",
    ),
    GateVerdict.LIMITED_WINDOW: (
        "limited {} (travel within 250 ms)",
        "more is asked for than limits.window_travel_max_rad",
    ),
    GateVerdict.FROZEN: ("held {}", "a check of the feedback said so"),
    GateVerdict.DENIED_CLOSED: ("denied {}", "it was closed, or the measured angle is beyond limits"),
    GateVerdict.DENIED_NOT_FINITE: ("denied {}", "the estimate was not finite"),
    GateVerdict.DENIED_TIME: ("denied {}", "time did not increase"),
    GateVerdict.DENIED_GAP: ("denied {}", "too long a time lay between two; it closed"),
    GateVerdict.DENIED_LATCHED: ("denied {}", "it has latched"),
    GateVerdict.DENIED_STALE: ("denied {}", "the sample was used before, or too old"),
}


def gate_lines(gate: Mapping[GateVerdict, GateCount]) -> list[str]:
    """Return a line for each kind of thing that the gate did besides letting pass."""
    return [_line(verdict, count) for verdict, count in gate.items()]


def _line(verdict: GateVerdict, count: GateCount) -> str:
    did, why = _WORDS[verdict]
    first = "before the drive was operational" if count.first_ns < 0 else f"first at {count.first_ns * 1e-9:.3f} s"
    several = f"{count.references} reference{'' if count.references == 1 else 's'}"
    by = f", by up to {count.greatest_cut_rad:.3g} rad" if count.greatest_cut_rad > 0.0 else ""
    return f"the gate {did.format(several)}, {first}{by}: {why}"


def gate_data(result: ServiceResult) -> dict[str, Any]:
    """Return the same as JSON, with what stopped the gate."""
    verdicts = {
        verdict.value: {
            "references": count.references,
            "first_s": None if count.first_ns < 0 else count.first_ns * 1e-9,
            "greatest_cut_rad": count.greatest_cut_rad,
        }
        for verdict, count in result.gate.items()
    }
    trip = result.gate_trip
    return {"verdicts": verdicts, "trip": None if trip is None else trip._asdict()}
