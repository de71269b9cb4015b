"""What the gate limited or denied in a run, as lines and as data for `run.json`."""

from typing import Any, Final

from hil_forceps.bridge.gate_tally import GateCount
from hil_forceps.bridge.results import ServiceResult
from hil_forceps.control.gate import GateTrip, GateVerdict

MAX_SHARE_OF_REFERENCES: Final = 0.5  # above it most references are limited
_RATES: Final = {
    GateVerdict.LIMITED_SPEED: "limits.speed_max_rad_per_s",
    GateVerdict.LIMITED_ACCELERATION: "limits.acceleration_max_rad_per_s2",
    GateVerdict.LIMITED_JERK: "limits.jerk_max_rad_per_s3",
    GateVerdict.LIMITED_WINDOW: "limits.window_travel_max_rad",
}

_WORDS = {
    GateVerdict.LIMITED_POSITION: (
        "limited {} (position)",
        "trajectory or compensation exceeds limits.position_min_rad or limits.position_max_rad",
    ),
    GateVerdict.LIMITED_SPEED: (
        "limited {} (speed)",
        "trajectory or compensation exceeds limits.speed_max_rad_per_s",
    ),
    GateVerdict.LIMITED_ACCELERATION: (
        "limited {} (acceleration)",
        "usual after a step of the load or a corner of the trajectory; limits.acceleration_max_rad_per_s2",
    ),
    GateVerdict.LIMITED_JERK: (
        "limited {} (jerk)",
        "usual after a step of the load or a corner of the trajectory; limits.jerk_max_rad_per_s3",
    ),
    GateVerdict.LIMITED_WINDOW: (
        "limited {} (travel within 250 ms)",
        "the motion exceeds limits.window_travel_max_rad",
    ),
    GateVerdict.FROZEN: ("held {}", "a check of the feedback failed"),
    GateVerdict.DENIED_CLOSED: ("denied {}", "the gate was closed, or the measured angle is beyond its limits"),
    GateVerdict.DENIED_NOT_FINITE: ("denied {}", "the estimate was not finite"),
    GateVerdict.DENIED_TIME: ("denied {}", "time did not increase"),
    GateVerdict.DENIED_GAP: ("denied {}", "the time between two references was too long, and the gate closed"),
    GateVerdict.DENIED_LATCHED: ("denied {}", "the gate has latched"),
    GateVerdict.DENIED_STALE: ("denied {}", "the sample was used before, or was too old"),
}


def gate_lines(result: ServiceResult) -> list[str]:
    """Return a line for each verdict of the gate other than passed; times from the start of the run."""
    asked = result.counters["pipeline"]["passed"] + result.counters["pipeline"]["denied"]
    return [_line(verdict, count, asked, began_ns(result)) for verdict, count in result.gate.items()]


def began_ns(result: ServiceResult) -> int:
    """Return the start of the run by the host's clock: when the service began to look for the drive."""
    return result.stages[0][0] if result.stages else 0


def _line(verdict: GateVerdict, count: GateCount, asked: int, began: int) -> str:
    did, why = _WORDS[verdict]
    if verdict in _RATES and count.references > MAX_SHARE_OF_REFERENCES * asked:
        why = f"these are most of the references; {_RATES[verdict]} is too small for this motion"
    if count.checks:
        why = f"failed check: {' and '.join(count.checks)} (docs/safety-gate.md)"
    by = f", by up to {count.greatest_cut_rad:.3g} rad" if count.greatest_cut_rad > 0.0 else ""
    number = f"{count.references} of {asked} reference{'' if asked == 1 else 's'}"
    return f"the gate {did.format(number)}, first {(count.first_ns - began) * 1e-9:.3f} s after the start{by}: {why}"


def gate_data(result: ServiceResult) -> dict[str, Any]:
    """Return the counts as data for JSON, with the trip of the gate if there was one."""
    verdicts = {
        verdict.value: {
            "references": count.references,
            "first_s": since_start_s(result, count.first_ns),
            "greatest_cut_rad": count.greatest_cut_rad,
        }
        | ({"checks": list(count.checks)} if count.checks else {})
        for verdict, count in result.gate.items()
    }
    trip = result.gate_trip
    return {"verdicts": verdicts, "trip": None if trip is None else _trip_data(result, trip)}


def since_start_s(result: ServiceResult, time_ns: int) -> float:
    """Return a time of the host's clock in s after the start of the run, to the microsecond."""
    return round((time_ns - began_ns(result)) * 1e-9, 6)


def _trip_data(result: ServiceResult, trip: GateTrip) -> dict[str, Any]:
    return {**trip._asdict(), "time_s": since_start_s(result, trip.time_ns)}
