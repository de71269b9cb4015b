"""`hil-forceps info`: installed versions, interfaces and ports, and figures derived from a rig."""

import json
import platform
import sys
from collections.abc import Iterator
from importlib.metadata import entry_points, version
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from firmware_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR
from hil_forceps import __version__
from hil_forceps.bench.run_folder import RECORDING_NAME
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.errors import UserError

LIBRARIES = ("python-can", "pyserial", "numpy", "scipy", "numba", "cantools", "mcap")
NET_DEVICES = Path("/sys/class/net")
ARPHRD_CAN = 280


def info(rig: Path | None = None, *, as_json: Annotated[bool, Parameter(name="--json", negative="")] = False) -> int:
    """Show installed versions, CAN interfaces and serial ports; with --rig, figures derived from the rig file.

    Parameters
    ----------
    rig
        Rig file; prints the frequency of the wire mode and the poles of the plant.
    as_json
        Print the result as JSON.
    """
    if rig is not None:
        _check_kind(rig)
    if as_json:
        told = _known() if rig is None else _derived(load_rig(rig))
        sys.stdout.write(json.dumps(told, indent=2) + "\n")
        return 0
    lines = list(_installed()) if rig is None else list(_explained(load_rig(rig)))
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


def _check_kind(path: Path) -> None:
    """UserError if the path is a run instead of a rig file."""
    if path.suffix == ".mcap" or (path / RECORDING_NAME).is_file():
        raise UserError(f"{path}: is a run, not a rig file; name a rig file, or use hil-forceps explain {path}")


def _known() -> dict[str, Any]:
    import serial.tools.list_ports  # noqa: PLC0415 - only this branch looks for ports

    return {
        "version": __version__,
        "protocol": f"{PROTOCOL_MAJOR}.{PROTOCOL_MINOR}",
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "libraries": {name: version(name) for name in LIBRARIES},
        "can_plugins": sorted(point.name for point in entry_points(group="can.interface")),
        "can_devices": _can_devices(),
        "serial_ports": sorted(port.device for port in serial.tools.list_ports.comports()),
        "drives": sorted(point.name for point in entry_points(group="hil_forceps.drive")),
    }


def _installed() -> Iterator[str]:
    found = _known()
    yield f"hil-forceps {found['version']}, protocol {found['protocol']}; not a medical device"
    yield f"Python {found['python']} on {found['system']}"
    yield "libraries: " + ", ".join(f"{name} {number}" for name, number in found["libraries"].items())
    yield f"CAN interfaces from plugins: {', '.join(found['can_plugins']) or 'none'}; besides those of python-can"
    none = "none (there is no SocketCAN device)"
    yield f"CAN devices of this kernel: {', '.join(found['can_devices']) or none}"
    yield f"serial ports: {', '.join(found['serial_ports']) or 'none'}"
    yield f"drives for `hil-forceps drive`: {', '.join(found['drives']) or 'none'}"


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


def _derived(rig: Rig) -> dict[str, Any]:
    from hil_forceps.model.linear import two_inertia  # noqa: PLC0415 - loads numba, which the bare `info` does not need

    plant = rig.plant()
    poles = [[float(pole.real), float(pole.imag)] for pole in two_inertia.poles_per_s(plant)]
    return {"wire_mode_rad_per_s": float(two_inertia.wire_mode_rad_per_s(plant)), "poles_per_s": poles}


def _explained(rig: Rig) -> Iterator[str]:
    found = _derived(rig)
    yield f"wire mode, undamped: {found['wire_mode_rad_per_s']:.1f} rad/s"
    poles = ", ".join(f"{real:.0f}{imaginary:+.0f}j" for real, imaginary in found["poles_per_s"])
    yield f"poles of the plant: {poles} 1/s"
