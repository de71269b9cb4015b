"""Rigs of the command line, and the kind and rate of the line to a rig's drive."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from hil_forceps.bridge.links.adapters import LinkSpec
from hil_forceps.drives.registry import framing_for, maker_profile
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError

NATIVE_BAUDRATE: Final = 1_000_000
VIRTUAL_INTERFACE: Final = "virtual_forceps"  # simulates the kind of line that the drive has


def named_rigs(paths: Sequence[Path]) -> dict[str, Rig]:
    """Return the rigs by the stems of their files; UserError if two are the same, or can't be a folder's name."""
    rigs: dict[str, Rig] = {}
    for path in paths:
        if path.stem in rigs:
            raise UserError(
                f"--rig {path}: another rig file is also named {path.stem}, and the name is the folder of its "
                "results; rename one"
            )
        if path.stem == "..":  # of a file `...yaml`
            raise UserError(f"--rig {path}: its name is the folder of its results, which can't be ..; rename it")
        rigs[path.stem] = load_rig(path)
    return rigs


def link_of(path: Path, rig: Rig, wanted: LinkSpec, baudrate: int | None) -> LinkSpec:
    """Return the link to the drive, with the rig's rates; UserError if the drive is on another kind of line."""
    return wanted._replace(
        fd=rig.bench.transport == "fd",
        bitrate_bit_per_s=rig.bench.bitrate_bit_per_s,
        data_bitrate_bit_per_s=rig.bench.data_bitrate_bit_per_s,
        baudrate=line_rate(path, rig, wanted.interface, wanted.serial_url, baudrate),
        framing=framing_for(rig),
    )


def line_rate(path: Path, rig: Rig, interface: str, serial: str, baudrate: int | None) -> int:
    """Return the rate of a serial line; UserError if the drive is on another kind of line."""
    found = maker_profile(rig)
    if found is None:
        return NATIVE_BAUDRATE if baudrate is None else baudrate
    profile, settings = found
    if profile.link == "can" and serial:
        raise UserError(
            f"--serial: the drive of {path} is on a CAN bus (`motor_driver:`); give --interface and --channel"
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
            f"--baudrate {baudrate}: {path} has motor_driver.baudrate_bit_per_s: {settings.baudrate_bit_per_s}, from "
            "which the stamps of samples are computed; leave --baudrate out, or change the rig file"
        )
    return settings.baudrate_bit_per_s
