"""The gate for the motor's reference: the last stage before one leaves. Nothing passes unless it is open and all is well."""

from hil_forceps.control.gate.limiter import CLOSED, DEFAULT_MAX_GAP_S, Gate, GateState, GateVerdict
from hil_forceps.control.gate.trip import GateTrip

__all__ = ["CLOSED", "DEFAULT_MAX_GAP_S", "Gate", "GateState", "GateTrip", "GateVerdict"]
