"""Units as they stand in measured files, and what a number in each is multiplied by to be in SI."""

import math
import re
from typing import NamedTuple

_TURN = 2.0 * math.pi


class Unit(NamedTuple):
    """A unit: what it measures (the SI unit as in columns' names), and its size in that."""

    kind: str  # "s", "rad", "rad_per_s", "A", "V", "N_m"; "count" and "rated" need a rig
    factor: float


UNITS = {
    "s": Unit("s", 1.0),
    "ms": Unit("s", 1e-3),
    "us": Unit("s", 1e-6),
    "ns": Unit("s", 1e-9),
    "min": Unit("s", 60.0),
    "rad": Unit("rad", 1.0),
    "mrad": Unit("rad", 1e-3),
    "deg": Unit("rad", math.pi / 180.0),
    "mdeg": Unit("rad", math.pi / 180e3),
    "rev": Unit("rad", _TURN),
    "rad/s": Unit("rad_per_s", 1.0),
    "deg/s": Unit("rad_per_s", math.pi / 180.0),
    "rev/s": Unit("rad_per_s", _TURN),
    "rpm": Unit("rad_per_s", _TURN / 60.0),
    "A": Unit("A", 1.0),
    "mA": Unit("A", 1e-3),
    "uA": Unit("A", 1e-6),
    "V": Unit("V", 1.0),
    "mV": Unit("V", 1e-3),
    "kV": Unit("V", 1e3),
    "Nm": Unit("N_m", 1.0),
    "mNm": Unit("N_m", 1e-3),
    "uNm": Unit("N_m", 1e-6),
    "Nmm": Unit("N_m", 1e-3),
    "Ncm": Unit("N_m", 1e-2),
    "kNm": Unit("N_m", 1e3),
    "counts": Unit("count", 1.0),
    "%": Unit("rated", 1e-2),
    "‰": Unit("rated", 1e-3),
}
# Words have no prefix, so capitals say nothing in them; of symbols they do (mA and MA).
_WORDS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("deg", "degree", "degrees", "°", "º"), "deg"),
    **dict.fromkeys(("rev", "revs", "revolutions", "turn", "turns"), "rev"),
    **dict.fromkeys(("rpm", "r/min", "rev/min", "1/min", "min^-1", "min-1", "u/min"), "rpm"),
    **dict.fromkeys(("rad/s", "radps"), "rad/s"),
    **dict.fromkeys(("deg/s", "°/s", "degps"), "deg/s"),
    **dict.fromkeys(("rev/s", "rps", "turns/s"), "rev/s"),
    **dict.fromkeys(("amp", "amps", "ampere", "amperes"), "A"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("count", "counts", "cnt", "cts", "inc", "incs", "increments", "ticks", "qc"), "counts"),
    "percent": "%",
}
_SPELLED = str.maketrans({"µ": "u", "μ": "u", "·": "", "⋅": "", "*": "", " ": "", "\t": "", "\xa0": ""})
_MAX_UNIT_CHARACTERS = 24
_IN_NAME = re.compile(r"(?<=[A-Za-z])_+(?=[A-Za-z])")


def unit_of(text: str) -> Unit | None:
    """Return the unit that is written so; None where it is none, or none of a run's.

    Spaces, points and stars between factors don't count, nor brackets around it all; `N_m` and `rad_per_s` are read
    as in columns' names.
    """
    text = text.strip()
    if len(text) > _MAX_UNIT_CHARACTERS:
        return None
    if len(text) > 1 and text[0] + text[-1] in ("[]", "()", "<>", "{}"):
        text = text[1:-1]
    text = text.translate(_SPELLED).replace("_per_", "/")
    text = _IN_NAME.sub("", text)
    found = text if text in UNITS else _WORDS.get(text.lower())
    return None if found is None else UNITS[found]
