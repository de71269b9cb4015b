"""The profiles of makers' protocols, and from a rig to the machine that speaks its drive's."""

from typing import Final

from firmware_protocol.host_machine import HostConfig, HostMachine
from hil_forceps.drives.cia402.profile import PROFILE as CIA402
from hil_forceps.drives.odrive.profile import PROFILE as ODRIVE
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.profile import Profile
from hil_forceps.drives.vesc.profile import PROFILE as VESC
from hil_forceps.rig import Rig
from hil_forceps.rig.sections import MotorDriver

PROFILES: Final[dict[str, Profile]] = {profile.name: profile for profile in (ODRIVE, CIA402, VESC)}


def maker_profile(rig: Rig) -> tuple[Profile, MotorDriver] | None:
    """Return the profile that a rig names, with its settings; None for the project's own protocol."""
    settings = rig.motor_driver
    return None if settings is None or settings.profile == "native" else (PROFILES[settings.profile], settings)


def machine_for(rig: Rig) -> DriveMachine:
    """Return the machine that speaks a rig's drive's protocol; UserError where the rig doesn't go with it."""
    found = maker_profile(rig)
    if found is None:
        return HostMachine(HostConfig(node=rig.bench.node_id, fd=rig.bench.transport == "fd"))
    profile, settings = found
    return profile.machine(rig, settings)


def sample_period_s(rig: Rig) -> float:
    """Return the nominal time between the samples that a rig's drive sends; UserError when its loop isn't known."""
    found = maker_profile(rig)
    if found is None:
        return rig.require_drive().sample_time_s * rig.bench.feedback_divider
    profile, settings = found
    return profile.sample_period_s(rig, settings)
