"""What the simulated drive shows on a live page: what really is, which no sensor says."""

import math
from collections.abc import Callable, Mapping
from typing import Final

from firmware_protocol.messages import DriveState
from hil_forceps.live.channel import STATUS_PERIOD_NS, Writer
from hil_forceps.live.description import AxisStatus, Code, Description, Field, Lane, Panel, Topic, Trace
from virtual_bus.plant.forceps import Truth

UNKNOWN: Final = 255  # the state of a drive that speaks its maker's protocol
_DEG: Final = math.degrees(1.0)
_NAMES: Final = ("theta_m_rad", "theta_j_rad", "tau_w_N_m", "elongation_m", "current_A")
_SCHEMA: Final = "int64 time_ns\n" + "".join(f"float64 {name.lower()}\n" for name in _NAMES) + "uint8 state\n"
TRUTH: Final = Topic(
    "/truth",
    "time_ns",
    (Field("int64", "time_ns"), *(Field("float64", name) for name in _NAMES), Field("uint8", "state")),
    "hil_forceps/msg/Truth",
    _SCHEMA,
)
PANELS: Final = (
    Panel("Motor angle θ_m", "°", _DEG, (Trace("/truth", "theta_m_rad", "θ_m"),)),
    Panel("Jaw angle θ_j", "°", _DEG, (Trace("/truth", "theta_j_rad", "θ_j"),)),
    Panel("Reaction torque τ_w", "mN m", 1e3, (Trace("/truth", "tau_w_N_m", "τ_w"),)),
    Panel("Motor current", "A", 1.0, (Trace("/truth", "current_A", "i", True),)),
    Panel("Wire elongation", "µm", 1e6, (Trace("/truth", "elongation_m", "x"),)),
)
_LEVELS: Final = ("off", "note", "ok", "bad")
LANES: Final = (
    Lane(
        "/truth",
        "state",
        "drive",
        (
            *((int(state), Code(state.name.lower(), level)) for state, level in zip(DriveState, _LEVELS, strict=True)),
            (UNKNOWN, Code("not known", "off")),
        ),
    ),
)


def description_of(title: str) -> Description:
    """Return what a page is told; its time is the drive's own since its start."""
    return Description(title, ("",), (TRUTH,), PANELS, LANES, 0)


class LiveTruth:
    """Takes each row of truth; `state` is asked for the drive's, `counts` for what it and its loop have counted."""

    def __init__(
        self,
        writer: Writer,
        state: Callable[[], DriveState | None],
        counts: Callable[[], Mapping[str, Mapping[str, object]]],
    ) -> None:
        self._writer = writer
        self._state = state
        self._counts = counts
        self._pack = TRUTH.record.pack
        self._next_ns = 0

    def see(self, time_ns: int, truth: Truth) -> None:
        """Show one row, and now and then the counters."""
        state = self._state()
        self._writer.put(0, 0, self._pack(time_ns, *truth, UNKNOWN if state is None else int(state)))
        if time_ns >= self._next_ns:
            self._next_ns = time_ns + STATUS_PERIOD_NS
            axis = AxisStatus("", "simulated drive", drive="not known" if state is None else state.name.lower())
            self._writer.post({"axes": [axis.as_data()], "counters": self._counts()})
