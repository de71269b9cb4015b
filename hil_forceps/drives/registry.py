"""From a rig to the machine that speaks its drive's protocol."""

from collections.abc import Callable, Mapping

from firmware_protocol.host_machine import HostConfig, HostMachine
from hil_forceps.drives.cia402 import HOST_NODE, Cia402, Cia402Config
from hil_forceps.drives.odrive import ODrive, ODriveConfig
from hil_forceps.drives.odrive_messages import MAX_NODE
from hil_forceps.drives.port import DriveMachine
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import MotorDriver


def machine_for(rig: Rig) -> DriveMachine:
    """Return the machine of the profile that a rig names; the project's own protocol where it names none."""
    settings = rig.motor_driver
    if settings is None or rig.drive_profile == "native":
        return HostMachine(HostConfig(node=rig.bench.node_id, fd=rig.bench.transport == "fd"))
    return _PROFILES[settings.profile](rig, settings)


def _check_node(settings: MotorDriver, lowest: int, highest: int) -> None:
    if not lowest <= settings.node_id <= highest:
        raise UserError(
            f"motor_driver.node_id: is {settings.node_id}, but a drive of the profile {settings.profile} has "
            f"{lowest} to {highest}; give its own"
        )


def _odrive(rig: Rig, settings: MotorDriver) -> DriveMachine:
    _check_node(settings, 0, MAX_NODE)
    return ODrive(
        ODriveConfig(
            node=settings.node_id,
            firmware=settings.firmware,
            rev_per_pulley_rev=settings.encoder_rev_per_pulley_rev,
            zero_rev=settings.encoder_zero_rev,
            velocity_limit_rad_per_s=rig.limits.speed_max_rad_per_s,
            current_limit_A=settings.current_limit_A,
            iq_period_ns=round(settings.current_period_s * 1e9),
        )
    )


def _cia402(rig: Rig, settings: MotorDriver) -> DriveMachine:
    _check_node(settings, 1, HOST_NODE - 1)  # 127 is the host's
    counts = rig.encoder.counts_per_rev
    if counts is None:
        raise UserError("encoder.counts_per_rev: is ideal, but a CiA 402 drive gives angles in counts; give a number")
    period_ns = round(rig.bench.host_period_s * 1e9)
    if period_ns % 1_000_000:
        raise UserError(
            f"bench.host_period_s: {rig.bench.host_period_s:g} s is no whole number of ms, which SYNC and the "
            "interpolation (60C2h) of a CiA 402 drive take; change it"
        )
    return Cia402(
        Cia402Config(
            node=settings.node_id,
            counts_per_pulley_rev=counts * settings.encoder_rev_per_pulley_rev,
            zero_counts=counts * settings.encoder_zero_rev,
            period_ns=period_ns,
            host_timeout_ns=round(settings.watchdog_s * 1e9),
        )
    )


_PROFILES: Mapping[str, Callable[[Rig, MotorDriver], DriveMachine]] = {"odrive": _odrive, "cia402": _cia402}
