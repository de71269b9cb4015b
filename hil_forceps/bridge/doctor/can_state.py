"""What the kernel says of a CAN device, read from `ip -details -json link show` and from sysfs; nothing raises."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from hil_forceps.bridge.doctor.check import why
from hil_forceps.bridge.doctor.reads import Reads

IFF_UP = 1
ARPHRD_CAN = 280  # linux/if_arp.h


class CanState(NamedTuple):
    """One device; None: it isn't said."""

    is_up: bool | None = None
    link_type: str | None = None  # can; or of what isn't one, as loopback
    kind: str | None = None  # can, vcan, ...
    bitrate_bit_per_s: int | None = None
    sample_point: float | None = None
    data_bitrate_bit_per_s: int | None = None
    data_sample_point: float | None = None
    is_fd: bool | None = None
    state: str | None = None  # of the controller, as ERROR-ACTIVE
    tx_errors: int | None = None
    rx_errors: int | None = None
    times_bus_off: int | None = None
    restart_ms: int | None = None
    queue_frames: int | None = None
    unread: str = ""  # why not all of it could be looked at


def read(reads: Reads, device: str) -> CanState | None:
    """Return a device's state; None where there is none of that name."""
    unread = ""
    try:
        state = parse(reads.run(("ip", "-details", "-statistics", "-json", "link", "show", "dev", device)))
        if state is not None:
            return state
        unread = "`ip -details -json link show` says nothing that is known here"
    except OSError as error:
        unread = why(error)
    folder = f"/sys/class/net/{device}"
    try:
        flags = int(reads.text(f"{folder}/flags"), 16)
    except (OSError, ValueError):
        return None
    is_can = _file(reads, f"{folder}/type") == ARPHRD_CAN
    link_type = "can" if is_can else "no CAN"
    return CanState(bool(flags & IFF_UP), link_type, queue_frames=_file(reads, f"{folder}/tx_queue_len"), unread=unread)


def parse(text: str) -> CanState | None:
    """Return the first device of iproute2's JSON; None where that is none. What is missing or odd in it is None."""
    try:
        links = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(links, list) or not links or not isinstance(links[0], dict):
        return None
    link = links[0]
    flags, info = link.get("flags"), _object(link.get("linkinfo"))
    data, counted = _object(info.get("info_data")), _object(info.get("info_xstats"))
    errors, timing, fast = (_object(data.get(name)) for name in ("berr_counter", "bittiming", "data_bittiming"))
    kind = _text(info.get("info_kind"))
    modes = data.get("ctrlmode")
    return CanState(
        is_up="UP" in flags if isinstance(flags, list) else None,
        link_type=_text(link.get("link_type")),
        kind=kind,
        bitrate_bit_per_s=_whole(timing.get("bitrate", data.get("bittiming_bitrate"))),
        sample_point=_number(timing.get("sample_point")),
        data_bitrate_bit_per_s=_whole(fast.get("bitrate", data.get("data_bittiming_bitrate"))),
        data_sample_point=_number(fast.get("sample_point")),
        is_fd=None if kind != "can" else isinstance(modes, list) and "FD" in modes,
        state=_text(data.get("state")),
        tx_errors=_whole(errors.get("tx")),
        rx_errors=_whole(errors.get("rx")),
        times_bus_off=_whole(counted.get("bus_off")),
        restart_ms=_whole(data.get("restart_ms")),
        queue_frames=_whole(link.get("txqlen")),
    )


def _file(reads: Reads, path: str) -> int | None:
    try:
        return int(reads.text(path))
    except (OSError, ValueError):
        return None


def _object(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _text(value: object) -> str | None:
    return value[:40] if isinstance(value, str) else None


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _number(value: object) -> float | None:
    """Return a number, which older releases of iproute2 write as text."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if 0.0 < number < 1.0 else None
