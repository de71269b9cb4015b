"""From the drive's command to what the motor gets: amplifier and dead time."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from virtual_bus.effects.composition import EffectNumbers
from virtual_bus.kernel import kernel, subroutine


class Queue(NamedTuple):
    """Commands on their way to the motor, oldest at `tally[1]`; times on a clock of their own, `tally[0]`."""

    tally: NDArray[np.int64]  # clock in ns, index of the oldest, how many
    due_ns: NDArray[np.int64]
    command_A: NDArray[np.float64]


def empty_queue(delay_s: float, sample_time_s: float) -> Queue:
    """Return a queue with room for every command that can be under way."""
    room = math.ceil(delay_s / sample_time_s) + 2
    return Queue(np.zeros(3, dtype=np.int64), np.zeros(room, dtype=np.int64), np.zeros(room))


@subroutine
def acting_command(command_A: float, e: EffectNumbers) -> float:
    """Return what the amplifier makes of a command: dead zone, then its limit; A."""
    if command_A > e.amplifier_deadband_half_width_A:
        beyond = command_A - e.amplifier_deadband_half_width_A
    elif command_A < -e.amplifier_deadband_half_width_A:
        beyond = command_A + e.amplifier_deadband_half_width_A
    else:
        beyond = 0.0
    return min(max(beyond, -e.current_saturation_limit_A), e.current_saturation_limit_A)


@kernel
def push_command(queue: Queue, command_A: float, delay_ns: int) -> None:
    """Send a command on its way; the oldest is forgotten when there is no room."""
    tally, room = queue.tally, queue.due_ns.size
    if tally[2] == room:
        tally[1], tally[2] = (tally[1] + 1) % room, room - 1
    last = (tally[1] + tally[2]) % room
    queue.due_ns[last], queue.command_A[last] = tally[0] + delay_ns, command_A
    tally[2] += 1
