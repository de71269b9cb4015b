"""What the gate says of a request, and how it describes the reference's motion."""

from enum import Enum


class GateVerdict(Enum):
    """What the gate did; the values name its counters. Their places are codes in recordings: new ones go to the end."""

    OPENED = "opened"  # first output: the measured angle
    PASSED = "passed"  # exactly what was requested
    LIMITED_POSITION = "limited_position"  # a bound, or the room to brake before it
    LIMITED_SPEED = "limited_speed"
    LIMITED_ACCELERATION = "limited_acceleration"
    DENIED_CLOSED = "denied_closed"  # not open; or opened with an angle that isn't within the bounds
    DENIED_NOT_FINITE = "denied_not_finite"
    DENIED_TIME = "denied_time"  # time did not increase
    DENIED_GAP = "denied_gap"  # too long since the last output: the gate has closed
    LIMITED_JERK = "limited_jerk"
    LIMITED_WINDOW = "limited_window"  # the travel within 250 ms, or the room to brake before it
    FROZEN = "frozen"  # a check of the feedback holds the reference where it is
    DENIED_LATCHED = "denied_latched"  # a check of the feedback has stopped the gate, until it is cleared
    DENIED_STALE = "denied_stale"  # no sample since the last output, or too old a one


# The reference as it moves, in differences over the time between two outputs: position [rad], speed [rad/s],
# acceleration [rad/s²] (0 where jerk isn't limited). Plain tuples, of which a tick makes several.
Motion = tuple[float, float, float]
Bounds = tuple[float, float]  # the lowest and the highest angle where the reference may be [rad]
Step = tuple[Motion, GateVerdict]
