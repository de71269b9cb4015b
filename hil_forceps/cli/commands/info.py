"""`hil-forceps info`: what is installed, what can be reached, what a rig means."""

import platform
import sys
from collections.abc import Iterator
from importlib.metadata import entry_points, version
from pathlib import Path

from firmware_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR
from hil_forceps import __version__
from hil_forceps.rig import Rig, load_rig

LIBRARIES = ("python-can", "pyserial", "numpy", "scipy", "numba", "cantools", "mcap")
NET_DEVICES = Path("/sys/class/net")
ARPHRD_CAN = 280


def info(rig: Path | None = None) -> int:
    """Say what is installed and which interfaces and ports are there; with --rig, what the rig means.

    Parameters
    ----------
    rig
        Rig file to explain: derived figures of the plant and the load on the bus.
    """
    lines = list(_installed()) if rig is None else list(_explained(load_rig(rig)))
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


def _installed() -> Iterator[str]:
    import serial.tools.list_ports  # noqa: PLC0415 - only this branch looks for ports

    yield f"hil-forceps {__version__}, protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}; not a medical device"
    yield f"Python {platform.python_version()} on {platform.system()} {platform.release()}"
    yield "libraries: " + ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    plugins = sorted(point.name for point in entry_points(group="can.interface"))
    yield f"CAN interfaces from plugins: {', '.join(plugins) or 'none'}; python-can's own come on top"
    yield f"CAN devices of this kernel: {', '.join(_can_devices()) or 'none (no SocketCAN device is there)'}"
    ports = sorted(port.device for port in serial.tools.list_ports.comports())
    yield f"serial ports: {', '.join(ports) or 'none'}"
    drives = sorted(point.name for point in entry_points(group="hil_forceps.drive"))
    yield f"drives for `hil-forceps drive`: {', '.join(drives) or 'none'}"


def _can_devices() -> list[str]:
    found = []
    for device in sorted(NET_DEVICES.iterdir()) if NET_DEVICES.is_dir() else []:
        try:
            kind = int((device / "type").read_text())
        except (OSError, ValueError):
            continue
        if kind == ARPHRD_CAN:
            found.append(device.name)
    return found


def _explained(rig: Rig) -> Iterator[str]:
    from hil_forceps.model import two_inertia  # noqa: PLC0415 - loads numba, which the bare `info` does not need

    plant = rig.plant()
    yield f"wire mode, undamped: {two_inertia.wire_mode_rad_per_s(plant):.1f} rad/s"
    poles = ", ".join(f"{p.real:.0f}{p.imag:+.0f}j" for p in two_inertia.poles_per_s(plant))
    yield f"poles of the plant: {poles} 1/s"
