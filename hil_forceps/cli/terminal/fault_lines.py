"""A fault in three lines on the terminal: what failed, when and in which state, and where the data are."""

import math
from pathlib import Path
from typing import Any

from hil_forceps.bench.fault_file import KeptFault
from hil_forceps.bridge.fault import FaultReason


def fault_lines(fault: KeptFault, message: str, folder: Path) -> list[str]:
    """Return the lines, without the command's name."""
    reason = fault.reason
    compared = f" ({reason.comparison})" if reason.comparison else ""
    at_s, ended_s = ((time_ns - fault.began_ns) / 1e9 for time_ns in (reason.time_ns, fault.ended_ns))
    held = f"; the run ended at {ended_s:.3f} s" if fault.ended_ns != reason.time_ns else ""
    kept = f"the last second is in {fault.path}" if not fault.problem else f"{fault.path}: {fault.problem}"
    return [
        f"{message}{compared}",
        f"  {at_s:.3f} s after the start, while {reason.stage}{held}; last state of the drive: {fault.drive_state}",
        f"  {kept}; hil-forceps explain {folder}",
    ]


def told_reason(reason: FaultReason) -> dict[str, Any]:
    """Return the reason for JSON; numbers that are not finite, because nothing was compared, become null."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in reason._asdict().items()
    }
