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
        Promise(10, "is identified in time, and is what the rig says", "the service gives up after that time"),
        Promise(20, "samples come at the promised rate", "a reference leaves for each sample, and for nothing else"),
        Promise(21, "stamps increase and keep pace with arrivals", "the estimators differentiate by them"),
        Promise(22, "nothing is damaged, missing or unpaired", "angle and current have to be of one instant"),
        Promise(30, "without torque the angle rests and there is no current", "an offset is estimated as load"),
        Promise(40, "enabling moves nothing", "a kick at the jaw before the first reference"),
        Promise(41, "holds where it is", "a jaw that wanders under torque follows nobody"),
        Promise(50, "goes the way of the reference", "with the wrong sign it runs to the end of its limits"),
        Promise(51, "follows a small step and comes back", "the compensation is a change of the reference"),
        Promise(52, "current has the sign of the torque", "else load is estimated as its opposite", "SHOULD"),
        Promise(60, "stops when references end, polled or not", "an estimator that stalls must stop the motor"),
        Promise(61, "stops when the host falls silent", "nobody is left to stop it"),
        Promise(62, "what the watchdog has stopped stays stopped", "torque that comes back by itself finds a hand"),
        Promise(70, "disable is confirmed by the drive's own word", "the service ends with that word"),
        Promise(71, "is without torque and current after each of five cycles", "`disabled` has to mean it"),
        Promise(72, "the emergency stop takes torque off", "it is all that a failing program still sends"),
        Promise(80, "tells a fault in words", "the user reads them"),
        Promise(81, "one reset clears the fault, and gives no torque", "a drive that needs a power cycle ends the day"),
        Promise(90, "stays within the limits", "they are those of the mechanism"),
        Promise(100, "samples are fresh enough for a reference in each period", "an older one moves nothing"),
        Promise(101, "a reference takes effect soon", "the delay limits what the compensation can do"),
    )
}
