"""What stopped the gate, as plain data and in words."""

from typing import Final, NamedTuple


class GateTrip(NamedTuple):
    """The check that stopped the gate, and what it compared."""

    check: str
    value: float
    limit: float
    unit: str
    time_ns: int  # host's clock

    def __str__(self) -> str:
        return f"{WORDS[self.check]}: {self.value:.4g} {self.unit}, the limit is {self.limit:.4g} {self.unit}"


JUMP: Final = "encoder_jump"
STILL: Final = "encoder_frozen"
AGAINST: Final = "against_current"
TENSION: Final = "tension"
CURRENT: Final = "current"
GAP: Final = "gap"

WORDS: Final = {
    JUMP: "the angle changes between two samples by more than the motor can move",
    STILL: "encoder frozen or motor blocked: the angle stays the same to the last bit while the reference moves",
    AGAINST: "encoder and current disagree: the motor keeps turning against a large current",
    TENSION: "the tension of the wire, by the balance of the motor, is beyond limits.tension_max_N",
    CURRENT: "the measured current is beyond limits.current_max_A",
    GAP: "the time between two references is too long",
}
IMPLAUSIBLE: Final = frozenset({JUMP, STILL, AGAINST})  # what is measured cannot be; the others are beyond a limit
