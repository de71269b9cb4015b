"""The gate for the motor's reference: the last stage before one leaves. It is closed unless opened."""

from hil_forceps.control.gate.gate import DEFAULT_MAX_GAP_S, Gate
from hil_forceps.control.gate.latch import GateState
from hil_forceps.control.gate.trip import GateTrip
from hil_forceps.control.gate.verdicts import GateVerdict

__all__ = ["DEFAULT_MAX_GAP_S", "Gate", "GateState", "GateTrip", "GateVerdict"]
