"""Every requirement of docs/protocol.md in a few words, and why some can't be judged from outside a drive."""

from typing import Final, NamedTuple

SHOULD: Final = frozenset({3, 52, 67})

_HOST = "binds the host"
_WIRE = "physical: what the adapter and the bit timing make of it can't be seen in frames"
_POWER = "needs a power cycle"

TITLES: Final[dict[int, str]] = {
    1: "ISO 11898-1, 11-bit ids, 1 Mbit/s",
    2: "extended ids and remote frames ignored",
    3: "sample point 75 to 87.5 %",
    10: "id is function x 32 + node",
    11: "node id 1 to 30",
    12: "acts on its own node, and on node 0 for three messages",
    13: "frames for others change nothing",
    20: "little-endian fields in their places",
    21: "wrong length dropped",
    22: "wrong format dropped",
    23: "reserved bits sent as zero",
    24: "reserved bits ignored",
    25: "a dropped frame changes the count only, by one",
    30: "CRC-8 of id and payload",
    31: "CRC-16 of id and payload in FD messages",
    32: "wrong check dropped, also one of another id",
    40: "sequences grow by one a frame",
    41: "halves of one measurement carry one sequence",
    42: "new is 1 to 127 ahead",
    43: "echo of the last reference accepted",
    44: "each measurement once, in order, whole",
    45: "missing measurements counted",
    46: "setpoints_lost grows by the sequences skipped",
    50: "stamp is the instant of the measurement",
    51: "stamp counts microseconds and never jumps",
    52: "clock accurate to 100 ppm",
    53: "angle modulo 2^32",
    54: "current saturates",
    55: "measurements in every state",
    56: "sent within one sample period",
    60: "DISCOVER answered within 35 ms in every state",
    61: "answer waits as its serial number says",
    62: "no second answer while one waits",
    63: "ASSIGN_NODE gives the new id",
    64: "ASSIGN_NODE refused while not DISABLED",
    65: "ASSIGN_NODE refused outside 1 to 30",
    66: "ASSIGN_NODE for another changes nothing",
    67: "node id kept over a power cycle",
    68: "IDENTITY after ASSIGN_NODE is no answer to DISCOVER",
    70: "nothing but DISCOVER and ESTOP before IDENTITY",
    71: "other major version refused",
    72: "other minor version accepted",
    73: "other serial number refused",
    74: "silent drive is gone",
    75: "restarted drive is noticed",
    80: "HOST_HEARTBEAT each period",
    81: "DRIVE_HEARTBEAT each period in every state",
    82: "DRIVE_HEARTBEAT within 5 ms after a change of state",
    83: "HOST_HEARTBEAT that is not new dropped",
    84: "host heartbeat timeout faults",
    85: "next sequence new, control bits high, after the host was lost",
    86: "rejected counts and saturates",
    87: "two heartbeats with low bits first",
    88: "ASSIGN_NODE to the present id is a change of node",
    90: "DISABLED after power-up",
    91: "torque in OPERATIONAL only",
    92: "rising ENABLE leads to ARMED",
    93: "ENABLE that stays high does not enable",
    94: "rising ENABLE with another major version faults",
    95: "another major version faults while enabled",
    96: "first reference within the tolerance: OPERATIONAL",
    97: "first reference further away: REFERENCE_MISMATCH",
    98: "no reference until the arm timeout: ENABLE_TIMEOUT",
    99: "ENABLE low leads to DISABLED",
    100: "newest angle as reference until OPERATIONAL",
    101: "references only when wanted and ARMED or OPERATIONAL",
    102: "sample_sequence of the newest measurement used",
    110: "fresh only when the sequence is new",
    111: "any sequence is new in ARMED",
    112: "reference from too old a sample dropped",
    113: "reference from a sample to come dropped",
    114: "references dropped in DISABLED and FAULT",
    115: "reference beyond a limit: REFERENCE_POSITION",
    116: "step beyond the limit: REFERENCE_RATE",
    117: "the motor follows the reference",
    118: "position limits judged before tolerance and step limit",
    120: "watchdog timeout: WATCHDOG",
    121: "a reference that comes too late does not save it",
    122: "nothing else feeds the watchdog",
    123: "torque gone 1 ms after the timeout",
    124: "watchdog timeout 1 to 500 ms, never off",
    130: "only a rising FAULT_RESET leaves FAULT",
    131: "first reason kept",
    132: "reset leads to DISABLED, also with ENABLE",
    133: "ENABLE must fall and rise after a reset",
    134: "FAULT_RESET that stays high resets nothing",
    135: "own protection faults in every state",
    140: "ESTOP in every state, any payload and format",
    141: "ESTOP in FAULT keeps the reason",
    142: "ESTOP without any heartbeat",
    150: "one answer to each request within 10 ms",
    151: "READ returns the value in force in every state",
    152: "UNKNOWN_INDEX",
    153: "READ_ONLY",
    154: "WRONG_STATE",
    155: "OUT_OF_RANGE",
    156: "UNKNOWN_OP",
    157: "order of refusals",
    158: "a refused request changes nothing, counts, returns the value",
    159: "an accepted WRITE is in force at once",
    160: "packet: id, payload, CRC-16; COBS; zero",
    161: "payload with its own check",
    162: "chunks of any size",
    163: "next good packet found after anything",
    164: "bad CRC, id or length dropped",
    165: "too long packets skipped",
    166: "empty packets ignored",
    167: "460.8 kbit/s at least",
    170: "FD_FEEDBACK in place of FEEDBACK and TIMING",
    171: "FD_SETPOINT only or SETPOINT only",
    172: "bit-rate switching",
    173: "the other kind of setpoint is not for this drive",
    180: "one whole packet in each datagram",
    181: "a torn datagram spoils no other",
    182: "answers to where the last datagram came from",
}

UNTESTABLE: Final[dict[int, str]] = {
    1: _WIRE,
    3: _WIRE,
    44: _HOST,
    45: _HOST,
    53: "needs 128 revolutions of the motor; the golden vectors hold it",
    54: "needs 6.5 A; the golden vectors hold it",
    67: _POWER,
    **dict.fromkeys((70, 71, 72, 73, 74, 75, 80, 87), _HOST),
    90: _POWER,
    **dict.fromkeys((100, 101, 102), _HOST),
    135: "needs an overcurrent, a broken encoder or the like; the golden vectors hold it",
    167: _WIRE,
    172: _WIRE,
    182: "needs a second host",
}


class Requirement(NamedTuple):
    """One numbered requirement; `untestable` says why it can't be judged from outside a drive, else is empty."""

    number: int
    title: str
    level: str
    untestable: str

    @property
    def name(self) -> str:
        """The number as the spec writes it."""
        return name_of(self.number)


def name_of(number: int) -> str:
    """Write a requirement's number as the spec does."""
    return f"HFP-{number:03d}"


REQUIREMENTS: Final = {
    number: Requirement(number, title, "SHOULD" if number in SHOULD else "MUST", UNTESTABLE.get(number, ""))
    for number, title in TITLES.items()
}
