"""What the service relies on in a maker's drive: each promise with its number, its words, and why it matters."""

from typing import Final, NamedTuple


class Promise(NamedTuple):
    """One promise; a SHOULD may stay open without harm."""

    number: int
    title: str
    why: str
    level: str = "MUST"

    @property
    def name(self) -> str:
        """The number as documents write it."""
        return f"DRV-{self.number:03d}"


PROMISES: Final = {
    promise.number: promise
    for promise in (
        Promise(10, "is identified in time, and is what the rig file says", "the service gives up after that time"),
        Promise(20, "samples come at the declared rate", "a reference is sent for each sample, and for nothing else"),
        Promise(21, "stamps increase and agree with the arrivals", "the estimators use them for derivatives"),
        Promise(22, "nothing is damaged, missing or unpaired", "angle and current have to be of one instant"),
        Promise(30, "without torque the angle is constant and there is no current", "an offset is estimated as load"),
        Promise(40, "enabling moves nothing", "the jaw would move before the first reference"),
        Promise(41, "holds its position", "a jaw that drifts does not follow its reference"),
        Promise(50, "moves in the direction of the reference", "with the wrong sign it runs to the end of its limits"),
        Promise(51, "follows a small step and comes back", "the compensation is a change of the reference"),
        Promise(52, "current has the sign of the torque", "else load is estimated as its opposite", "SHOULD"),
        Promise(
            60,
            "stops when references end, whether or not the host still reads samples",
            "if the estimator stops, the motor must stop",
        ),
        Promise(61, "stops when the host sends nothing", "no other device would stop the motor"),
        Promise(62, "stays stopped after its watchdog has tripped", "torque that returns by itself can injure"),
        Promise(70, "confirms that it is disabled", "the service ends with that confirmation"),
        Promise(71, "is without torque and current after each of five cycles", "`disabled` has to be true"),
        Promise(72, "the emergency stop takes torque off", "it is the last frame that a failing program sends"),
        Promise(80, "reports a fault in words", "the user reads them"),
        Promise(81, "one reset clears the fault, and gives no torque", "otherwise each fault would need a power cycle"),
        Promise(90, "stays within the limits", "they are those of the mechanism"),
        Promise(
            100, "samples are recent enough for a reference in each period", "no reference is sent from an older sample"
        ),
        Promise(101, "a reference takes effect soon", "the delay limits the compensation"),
    )
}
