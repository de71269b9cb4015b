"""The line to a rig's drive: of which kind it is, and at which rate it runs."""

from pathlib import Path
from typing import Final

from hil_forceps.drives.registry import maker_profile
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

NATIVE_BAUDRATE: Final = 1_000_000
VIRTUAL_INTERFACE: Final = "virtual_forceps"  # has the drive's own kind of line in it


def line_rate(path: Path, rig: Rig, interface: str, serial: str, baudrate: int | None) -> int:
    """Return the rate of a serial line; UserError where the drive is on another kind of line."""
    found = maker_profile(rig)
    if found is None:
        return NATIVE_BAUDRATE if baudrate is None else baudrate
    profile, settings = found
    if profile.link == "can" and serial:
        raise UserError(
            f"--serial: {path} describes a drive on a CAN bus (`motor_driver:`); give --interface and --channel"
        )
    if profile.link == "can" and not interface:
        raise UserError(f"{path}: motor_driver.profile: {profile.name} is on a CAN bus; give --interface and --channel")
    if profile.link == "serial" and not serial and interface != VIRTUAL_INTERFACE:
        raise UserError(
            f"{path}: motor_driver.profile: {profile.name} is on a serial line; give --serial PORT, or --interface "
            f"{VIRTUAL_INTERFACE} for a simulated one"
        )
    if profile.link == "serial" and baudrate not in {None, settings.baudrate_bit_per_s}:
        raise UserError(
            f"--baudrate {baudrate}: {path} says motor_driver.baudrate_bit_per_s: {settings.baudrate_bit_per_s}, by "
            "which samples are stamped; leave it out, or change it there"
        )
    return settings.baudrate_bit_per_s
