"""A serial port: is it there, may it be used, and does its adapter hold bytes back."""

from collections.abc import Iterator
from pathlib import PurePath
from typing import Final

from hil_forceps.bridge.doctor.check import Check, Verdict, unknown, why
from hil_forceps.bridge.doctor.reads import Reads
from hil_forceps.rig.sections import Limits

MIN_LATENCY_MS: Final = 1  # of an FTDI's latency timer; 16 is its default (FTDI AN232B-04)
_ASYNC_LOW_LATENCY: Final = 1 << 13  # linux/tty_flags.h; in /sys/class/tty/NAME/flags of ports that have a UART


def checks(reads: Reads, path: str, limits: Limits) -> Iterator[Check]:
    """Look at a port by its path; a URL has nothing to look at."""
    if "://" in path:
        yield unknown("serial.port", f"the serial port {path}", "it is a URL, not a device")
        return
    yield _port(reads, path)
    try:
        device = PurePath(reads.target(path)).name
    except (OSError, RuntimeError):  # RuntimeError: links in a circle
        return
    yield _driver(reads, device)
    yield _latency(reads, device, limits)
    yield _low_latency(reads, device)


def _port(reads: Reads, path: str) -> Check:
    name, what = "serial.port", f"whether {path} may be used"
    try:
        if reads.may_open(path):
            return Check(name, what, Verdict.OK, "it exists, and can be read and written")
    except OSError as error:
        remedy = "python3 -m serial.tools.list_ports"
        return Check(name, what, Verdict.FAIL, error.strerror or "there is no such port", remedy)
    text = "it exists, but this user may not read and write it"
    return Check(name, what, Verdict.FAIL, text, "sudo usermod -aG dialout $USER, then log in again")


def _driver(reads: Reads, device: str) -> Check:
    name, what = "serial.driver", f"driver of {device}"
    try:
        return Check(name, what, Verdict.OK, PurePath(reads.target(f"/sys/class/tty/{device}/device/driver")).name)
    except (OSError, RuntimeError):
        return unknown(name, what, "no driver is listed: a pseudo terminal, or a port without hardware")


def _latency(reads: Reads, device: str, limits: Limits) -> Check:
    name, what = "serial.latency", f"how long {device}'s adapter holds bytes back (latency_timer)"
    path = f"/sys/class/tty/{device}/device/latency_timer"
    try:
        latency_ms = int(reads.text(path))
    except OSError:
        return unknown(name, what, "this adapter has no latency timer")
    except ValueError:
        return unknown(name, what, f"{path} contains no number")
    text, age_ms = f"{latency_ms} ms", limits.max_sample_age_s * 1e3
    if latency_ms <= MIN_LATENCY_MS:
        return Check(name, what, Verdict.OK, text, "", latency_ms, "ms")
    remedy = f"echo {MIN_LATENCY_MS} | sudo tee {path}"
    if latency_ms > age_ms:
        text += f": samples are older than limits.max_sample_age_s ({age_ms:g} ms), so that no reference is sent"
        return Check(name, what, Verdict.FAIL, text, remedy, latency_ms, "ms")
    return Check(name, what, Verdict.WARN, f"{text}: added to the age of each sample", remedy, latency_ms, "ms")


def _low_latency(reads: Reads, device: str) -> Check:
    name, what = "serial.low_latency", f"low_latency flag of {device}"
    path = f"/sys/class/tty/{device}/flags"
    try:
        flags = int(reads.text(path), 0)
    except OSError as error:
        return unknown(name, what, why(error))
    except ValueError:
        return unknown(name, what, f"{path} contains no number")
    if flags & _ASYNC_LOW_LATENCY:
        return Check(name, what, Verdict.OK, "set")
    return Check(name, what, Verdict.WARN, "not set", f"setserial /dev/{device} low_latency")
