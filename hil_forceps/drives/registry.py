"""The profiles of makers' protocols, and from a rig to the machine that speaks its drive's."""

from collections.abc import Iterable, Sequence
from typing import Final

from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.frames import arbitration_id
from firmware_protocol.host.machine import HostConfig, HostMachine
from firmware_protocol.messages import Function
from hil_forceps.drives.cia402.profile import PROFILE as CIA402
from hil_forceps.drives.dynamixel.profile import PROFILE as DYNAMIXEL
from hil_forceps.drives.framing import NATIVE, Framing
from hil_forceps.drives.inquiry import Inquiry
from hil_forceps.drives.mit.profile import PROFILE as MIT
from hil_forceps.drives.moteus.profile import PROFILE as MOTEUS
from hil_forceps.drives.native_inquiry import NativeInquiry
from hil_forceps.drives.odrive.profile import PROFILE as ODRIVE
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.profile import Profile
from hil_forceps.drives.vesc.profile import PROFILE as VESC
from hil_forceps.rig import Rig
from hil_forceps.rig.sections import MotorDriver
from hil_forceps.rig.validation.consistency import native_bus_load

NATIVE_WATCHDOG_S: Final = 1e-6 * DriveConfig.watchdog_timeout_us
NATIVE_REACTION_S: Final = 1e-3  # HFP-123

PROFILES: Final[dict[str, Profile]] = {
    profile.name: profile for profile in (ODRIVE, CIA402, MIT, MOTEUS, DYNAMIXEL, VESC)
}


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


def machines_for(rigs: Sequence[Rig]) -> list[DriveMachine]:
    """Return the machines of rigs on one bus, in their order; UserError where a rig doesn't go with its drive."""
    machines = [machine_for(rig) for rig in rigs]
    for profile in PROFILES.values():
        found = [(place, rig, rig.motor_driver) for place, rig in enumerate(rigs) if rig.drive_profile == profile.name]
        if profile.machines is not None and len(found) > 1:
            together = profile.machines([(rig, settings) for _, rig, settings in found if settings is not None])
            for (place, _, _), machine in zip(found, together, strict=True):
                machines[place] = machine
    return machines


def bus_load(rig: Rig) -> float:
    """Return the share of the line's time that a rig's cyclic frames take, at worst; UserError without its loop."""
    found = maker_profile(rig)
    if found is None:
        bench, loop = rig.bench, rig.require_drive()
        rates = (bench.bitrate_bit_per_s, bench.data_bitrate_bit_per_s, bench.host_period_s)
        return native_bus_load(bench.transport, *rates, loop.sample_time_s, bench.feedback_divider)
    profile, settings = found
    return profile.bus_load(rig, settings)


def current_limit_A(rig: Rig) -> float | None:
    """Return the most current that a rig's drive gives its motor, as far as the rig says."""
    found = maker_profile(rig)
    limits = [] if rig.drive is None else [rig.drive.current_limit_A]
    if found is not None and found[0].tells_current_limit:
        limits.append(found[1].current_limit_A)
    return min(limits, default=None)


def shared_load(rigs: Iterable[Rig]) -> float:
    """Return what `bus_load` of these rigs' drives has in it more than once, although their bus has it once."""
    total, seen = 0.0, set()
    for rig in rigs:
        if rig.drive_profile in seen:
            total += PROFILES[rig.drive_profile].shared_load(rig)
        elif rig.drive_profile in PROFILES:
            seen.add(rig.drive_profile)
    return total


def ids_in_common(rig: Rig, other: Rig) -> frozenset[tuple[int, bool]]:
    """Return the arbitration ids that both use, but for those which one host may have for both drives."""
    if rig.drive_profile == other.drive_profile:
        return ids_of(rig) & ids_of(other)
    return (ids_of(rig) | _bus_ids(rig)) & (ids_of(other) | _bus_ids(other))


def _bus_ids(rig: Rig) -> frozenset[tuple[int, bool]]:
    found = maker_profile(rig)
    return frozenset() if found is None else found[0].bus_ids


def ids_of(rig: Rig) -> frozenset[tuple[int, bool]]:
    """Return the arbitration ids of a rig's drive, each with whether it has 29 bits."""
    found = maker_profile(rig)
    if found is None:
        return frozenset((arbitration_id(function, rig.bench.node_id), False) for function in Function)
    profile, settings = found
    return profile.ids(settings)


def framing_for(rig: Rig) -> Framing:
    """Return how packets of a rig's drive are packed on a serial line."""
    found = maker_profile(rig)
    return NATIVE if found is None else found[0].framing


def torque_free_within_s(rig: Rig) -> float | None:
    """Return the time from the last fresh reference that reaches a rig's drive until nothing leads its motor any more.

    Watchdog, what its profile promises beyond (`Promises.reaction_s`), and a period of the host's loop for the rest.
    A Dynamixel stops and keeps its torque, a moteus brakes where its `timeout_mode` says so. None: no watchdog does it.
    The native protocol's is that of its default parameter and HFP-123.
    """
    found = maker_profile(rig)
    if found is None:
        return NATIVE_WATCHDOG_S + NATIVE_REACTION_S
    profile, settings = found
    reaction_s = profile.promises(rig, settings).reaction_s
    if settings.watchdog_s == 0.0 or reaction_s is None:
        return None
    return settings.watchdog_s + reaction_s + rig.bench.host_period_s


def sample_period_s(rig: Rig) -> float:
    """Return the nominal time between the samples that a rig's drive sends; UserError when its loop isn't known."""
    found = maker_profile(rig)
    if found is None:
        return rig.require_drive().sample_time_s * rig.bench.feedback_divider
    profile, settings = found
    return profile.sample_period_s(rig, settings)


def inquiry_for(rig: Rig) -> Inquiry | None:
    """Return what asks a rig's drive who it is and changes nothing; None where it answers to commands alone."""
    found = maker_profile(rig)
    if found is None:
        return NativeInquiry(rig.bench.node_id)
    profile, settings = found
    return None if profile.inquiry is None else profile.inquiry(settings)
