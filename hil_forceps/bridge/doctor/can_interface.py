"""A SocketCAN device beside the rig: up, bit timing, controller, error counters, queue."""

from collections.abc import Iterator
from typing import Final

from hil_forceps.bridge.doctor.can_state import CanState, read
from hil_forceps.bridge.doctor.check import Check, Verdict, unknown
from hil_forceps.bridge.doctor.reads import Reads
from hil_forceps.drives.line_use import most_bits
from hil_forceps.rig.sections import BenchSettings, Limits

VALID_SAMPLE_POINTS: Final = (0.75, 0.90)  # CiA 301: 87.5 %, 75 % to 90 % are valid at 1 Mbit/s
ERROR_WARNING_COUNT, ERROR_PASSIVE_COUNT = 96, 128  # ISO 11898-1: of the error counters
_CLASSIC_BYTES: Final = 8


def checks(reads: Reads, device: str, bench: BenchSettings | None, limits: Limits) -> Iterator[Check]:
    """Look at a device; `bench`: of the rig, None without one."""
    what = f"the CAN device {device}"
    state = read(reads, device)
    if state is None:
        remedy = (
            "ip -brief link show type can lists the devices; the adapter may need its driver, or `sudo modprobe "
            "can_raw`"
        )
        yield Check("can.up", what, Verdict.FAIL, f"there is no CAN device {device}", remedy)
        return
    if state.link_type not in {"can", None}:
        text = f"{device} is not a CAN device ({state.link_type})"
        yield Check("can.up", what, Verdict.FAIL, text, "ip -brief link show type can; ip -brief link show type vcan")
        return
    yield _up(state, device, bench)
    if state.kind == "vcan":
        yield Check("can.bit_rate", what, Verdict.OK, "vcan has no bit rate and no controller")
    else:
        yield from _bit_timing(state, device, bench)
        yield _controller(state, device)
        yield _errors(state, device)
        yield _restart(state, device)
    yield _queue(state, device, bench or BenchSettings(), limits)


def set_up_line(device: str, bench: BenchSettings | None) -> str:
    """Return the line that sets a device up as a rig wants it."""
    settings = bench or BenchSettings()
    line = f"sudo ip link set {device} down; sudo ip link set {device} up type can "
    if settings.transport == "fd":
        rates = f"bitrate {settings.bitrate_bit_per_s} dbitrate {settings.data_bitrate_bit_per_s}"
        return f"{line}{rates} fd on"
    return f"{line}bitrate {settings.bitrate_bit_per_s}"


def _up(state: CanState, device: str, bench: BenchSettings | None) -> Check:
    name, what = "can.up", f"whether {device} is up"
    if state.is_up is None:
        return unknown(name, what, "the system does not report its flags")
    if state.is_up:
        return Check(name, what, Verdict.OK, "up")
    return Check(name, what, Verdict.FAIL, "down", set_up_line(device, bench))


def _bit_timing(state: CanState, device: str, bench: BenchSettings | None) -> Iterator[Check]:
    wanted = None if bench is None else bench.bitrate_bit_per_s
    remedy = set_up_line(device, bench)
    yield _rate(
        "can.bit_rate", f"bit rate of {device}, compared with the rig", state, state.bitrate_bit_per_s, wanted, remedy
    )
    yield _sample_point("can.sample_point", f"sample point of {device}", state, state.sample_point, remedy)
    if bench is None or bench.transport != "fd":
        return
    what = f"bit rate of {device} in the data phase, compared with the rig"
    if state.is_fd is False:
        yield Check("can.data_bit_rate", what, Verdict.FAIL, "CAN FD is off, but the rig has transport: fd", remedy)
    else:
        fast, rate = state.data_bitrate_bit_per_s, bench.data_bitrate_bit_per_s
        yield _rate("can.data_bit_rate", what, state, fast, rate, remedy)


def _rate(name: str, what: str, state: CanState, rate: int | None, wanted: int | None, remedy: str) -> Check:
    if rate is None:
        return unknown(name, what, state.unread or "the device does not report it")
    text = f"{rate / 1e3:g} kbit/s"
    if wanted is None:
        return Check(name, what, Verdict.OK, f"{text}; not compared, because there is no --rig", "", rate, "bit/s")
    if rate != wanted:
        text += f", the rig has {wanted / 1e3:g} kbit/s: no frame would be received, and each would be a bus error"
        return Check(name, what, Verdict.FAIL, text, remedy, rate, "bit/s")
    return Check(name, what, Verdict.OK, text, "", rate, "bit/s")


def _sample_point(name: str, what: str, state: CanState, point: float | None, remedy: str) -> Check:
    if point is None:
        return unknown(name, what, state.unread or "the device does not report it")
    low, high = VALID_SAMPLE_POINTS
    text = f"{100.0 * point:g} %"
    if low <= point <= high:
        return Check(name, what, Verdict.OK, text, "", point, "")
    text += (
        f", outside of {100.0 * low:g} to {100.0 * high:g} %: bus errors are likely on long lines and with other "
        "nodes' clock tolerance"
    )
    return Check(name, what, Verdict.WARN, text, f"{remedy} sample-point 0.875", point, "")


def _controller(state: CanState, device: str) -> Check:
    name, what = "can.state", f"state of {device}'s controller"
    if state.state is None:
        return unknown(name, what, state.unread or "the device does not report it")
    times = f", {state.times_bus_off} times bus-off since it came up" if state.times_bus_off else ""
    text = f"{state.state}{times}"
    if state.state == "BUS-OFF":
        remedy = f"sudo ip link set {device} down; sudo ip link set {device} up; check wiring, termination, bit rate"
        return Check(name, what, Verdict.FAIL, text, remedy)
    if state.state in {"STOPPED", "SLEEPING"}:
        return Check(name, what, Verdict.FAIL, text, f"sudo ip link set {device} up")
    if state.state == "ERROR-ACTIVE" and not times:
        return Check(name, what, Verdict.OK, text)
    remedy = f"check wiring, termination (60 Ω between the lines) and bit rate; candump -e {device}"
    return Check(name, what, Verdict.WARN, text, remedy)


def _errors(state: CanState, device: str) -> Check:
    name, what = "can.errors", f"error counters of {device}'s controller"
    if state.tx_errors is None or state.rx_errors is None:
        return unknown(name, what, state.unread or "the driver of this controller does not report them")
    most = max(state.tx_errors, state.rx_errors)
    text = f"{state.tx_errors} sending, {state.rx_errors} receiving"
    remedy = f"check wiring, termination, bit rate, and that another node is on the bus; candump -e {device}"
    if most == 0:
        return Check(name, what, Verdict.OK, text, "", most, "errors")
    if most < ERROR_WARNING_COUNT:
        return Check(name, what, Verdict.WARN, f"{text}: frames were damaged recently", remedy, most, "errors")
    limit = (
        f"passive from {ERROR_PASSIVE_COUNT}" if most >= ERROR_PASSIVE_COUNT else f"warning from {ERROR_WARNING_COUNT}"
    )
    return Check(name, what, Verdict.FAIL, f"{text} ({limit})", remedy, most, "errors")


def _restart(state: CanState, device: str) -> Check:
    name, what = "can.restart", f"whether {device} comes back by itself from bus-off (restart-ms)"
    if state.restart_ms is None:
        return unknown(name, what, state.unread or "the device does not report it")
    if state.restart_ms == 0:
        return Check(name, what, Verdict.OK, "no, it stays off", "", 0.0, "ms")
    text = f"after {state.restart_ms} ms: references in its queue are then sent late"
    remedy = f"sudo ip link set {device} type can restart-ms 0"
    return Check(name, what, Verdict.WARN, text, remedy, state.restart_ms, "ms")


def _queue(state: CanState, device: str, bench: BenchSettings, limits: Limits) -> Check:
    name, what = "can.queue", f"how old a reference can get in {device}'s queue (txqueuelen)"
    frames = state.queue_frames
    if frames is None or frames < 0:
        return unknown(name, what, state.unread or "the device does not report it")
    longest_s = frames * most_bits(_CLASSIC_BYTES, is_fd=False, is_extended=False)[0] / bench.bitrate_bit_per_s
    age_s = limits.max_sample_age_s
    text = f"{frames} frames, {longest_s * 1e3:.3g} ms to send all of them"
    if longest_s <= age_s:
        return Check(name, what, Verdict.OK, text, "", frames, "frames")
    text += f"; limits.max_sample_age_s is {age_s * 1e3:g} ms"
    return Check(name, what, Verdict.WARN, text, f"sudo ip link set {device} txqueuelen 10", frames, "frames")
