"""From a rig to the machine that speaks its drive's protocol."""

from collections.abc import Callable, Mapping

from firmware_protocol.host_machine import HostConfig, HostMachine
from hil_forceps.drives.odrive import ODrive, ODriveConfig
from hil_forceps.drives.port import DriveMachine
from hil_forceps.rig import Rig
from hil_forceps.rig.sections import MotorDriver


def machine_for(rig: Rig) -> DriveMachine:
    """Return the machine of the profile that a rig names; the project's own protocol where it names none."""
    settings = rig.motor_driver
    if settings is None or settings.profile == "native":
        return HostMachine(HostConfig(node=rig.bench.node_id, fd=rig.bench.transport == "fd"))
    return _PROFILES[settings.profile](rig, settings)


def _odrive(rig: Rig, settings: MotorDriver) -> DriveMachine:
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


_PROFILES: Mapping[str, Callable[[Rig, MotorDriver], DriveMachine]] = {"odrive": _odrive}
