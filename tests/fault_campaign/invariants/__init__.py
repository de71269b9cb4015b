"""What must hold in every run, told by the world: what reached the drive, what it did, what the file holds."""

from collections.abc import Callable, Iterator
from typing import Final

from tests.fault_campaign.invariants.ending import right_end
from tests.fault_campaign.invariants.motion import (
    gate_limits_as_sent,
    implausible_feedback_stops,
    limits_at_the_drive,
    no_kick,
)
from tests.fault_campaign.invariants.recording import every_sample_is_recorded, lost_samples_are_counted
from tests.fault_campaign.invariants.references import no_burst_at_the_drive, no_queued_burst, no_stale_sample
from tests.fault_campaign.invariants.torque import torque_free_in_time
from tests.fault_campaign.run import Record

INVARIANTS: Final[dict[str, Callable[[Record], Iterator[str]]]] = {
    "limits": limits_at_the_drive,
    "gate": gate_limits_as_sent,
    "kick": no_kick,
    "implausible": implausible_feedback_stops,
    "stale": no_stale_sample,
    "burst": no_queued_burst,
    "wire burst": no_burst_at_the_drive,
    "torque": torque_free_in_time,
    "recorded": every_sample_is_recorded,
    "lost": lost_samples_are_counted,
    "end": right_end,
}  # and "same bytes", which takes two runs (`campaign.judge`)


def findings(record: Record) -> list[str]:
    """Return what doesn't hold, each with its invariant's name."""
    return [f"{name}: {text}" for name, holds in INVARIANTS.items() for text in holds(record)]
