"""A VESC's faults in words: `mc_fault_code` of datatypes.h, firmware 7.01."""

from typing import Final

_WORDS: Final = (
    "none", "over voltage", "under voltage", "gate driver (DRV)", "absolute over current", "MOSFET over temperature",
    "motor over temperature", "gate driver over voltage", "gate driver under voltage", "supply of the controller low",
    "booted from a watchdog reset", "encoder: SPI", "encoder: sine and cosine too small",
    "encoder: sine and cosine too large", "flash corrupted", "offset of current sensor 1", "offset of current sensor 2",
    "offset of current sensor 3", "unbalanced currents", "brake", "resolver: loss of tracking",
    "resolver: degradation of signal", "resolver: loss of signal", "flash corrupted: app configuration",
    "flash corrupted: motor configuration", "encoder: no magnet", "encoder: magnet too strong", "phase filter",
    "encoder", "output", "encoder slip", "overspeed", "underspeed", "absolute overspeed",
)  # fmt: skip


def fault_words(fault: int) -> str:
    """Return a fault code in words, one that isn't known here by its number alone."""
    return f"fault {fault} ({_WORDS[fault]})" if 0 < fault < len(_WORDS) else f"fault {fault}"
