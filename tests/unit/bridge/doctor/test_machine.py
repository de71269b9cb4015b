"""Checks of the machine, on recorded machines: each is seen to be well, to warn, and not to be able to look."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_forceps.bridge.doctor import disk, machine
from hil_forceps.bridge.doctor.check import Check, Verdict
from hil_forceps.bridge.doctor.reads import MAX_READ_BYTES, ClockStatus, Space, System
from tests.recorded_machine import Recorded

SLACK = "/proc/self/timerslack_ns"
SOURCE = "/sys/devices/system/clocksource/clocksource0/current_clocksource"
ISOLATED = "/sys/devices/system/cpu/isolated"
GOVERNOR = "/sys/devices/system/cpu/cpu{}/cpufreq/scaling_governor"
GOOD = {
    SLACK: "50000\n",
    SOURCE: "tsc\n",
    ISOLATED: "\n",
    GOVERNOR.format(0): "performance\n",
    GOVERNOR.format(1): "performance\n",
    "/sys/devices/system/cpu/cpufreq/policy0/x": "",
}


def looked(recorded: Recorded) -> dict[str, Check]:
    return {check.id: check for check in machine.checks(recorded)}


def test_a_machine_made_for_it_is_well(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path, GOOD)
    recorded.policy = (os.SCHED_FIFO, 50)
    found = looked(recorded)
    assert len(found) == 6
    assert {check.verdict for check in found.values()} == {Verdict.OK}
    assert all(not check.remedy for check in found.values())


@pytest.mark.parametrize(
    ("files", "name", "text", "remedy"),
    [
        ({SLACK: "500000"}, "machine.timer_slack", "500 µs", "inherited"),
        ({SOURCE: "hpet"}, "machine.clock_source", "hpet", "available_clocksource"),
        ({SOURCE: "acpi_pm"}, "machine.clock_source", "acpi_pm", "dmesg"),
        ({GOVERNOR.format(1): "powersave"}, "machine.governor", "powersave", "cpupower frequency-set -g performance"),
        ({ISOLATED: "1"}, "machine.cores", "core 1 is isolated", "taskset -c 1"),
        ({ISOLATED: "2-3"}, "machine.cores", "core 2,3 is isolated", "taskset -c 2"),
        ({}, "machine.scheduling", "SCHED_OTHER", "chrt --fifo 50"),
    ],
)
def test_what_makes_a_loop_late_is_warned_of(
    tmp_path: Path, files: Mapping[str, str], name: str, text: str, remedy: str
) -> None:
    check = looked(Recorded(tmp_path, GOOD).put(files))[name]
    assert check.verdict is Verdict.WARN
    assert text in check.text
    assert remedy in check.remedy


def test_a_process_on_the_isolated_core_is_well(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path, {**GOOD, ISOLATED: "1"})
    recorded.allowed = frozenset({1})
    assert looked(recorded)["machine.cores"].verdict is Verdict.OK


def test_a_clock_that_nobody_sets_is_warned_of(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path, GOOD)
    recorded.clock = ClockStatus(False, 16.0)
    check = looked(recorded)["machine.clock"]
    assert (check.verdict, check.remedy) == (Verdict.WARN, "sudo timedatectl set-ntp true")


def test_what_can_not_be_read_is_told_with_its_reason(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.policy = recorded.allowed = recorded.clock = None
    found = looked(recorded)
    assert {check.verdict for check in found.values()} == {Verdict.UNKNOWN}
    assert "Operation not permitted" in found["machine.scheduling"].text
    assert (
        "scaling_governor"
        in looked(Recorded(tmp_path, {"/sys/devices/system/cpu/cpu0/x": ""}))["machine.governor"].text
    )


@given(st.text(max_size=60))
def test_no_text_of_the_kernel_raises(text: str) -> None:
    cores = machine.parse_cores(text)
    assert cores is None or all(core >= 0 for core in cores)


@pytest.mark.parametrize(
    ("text", "cores"),
    [("", set()), ("2-3,6\n", {2, 3, 6}), ("0", {0}), ("3-", None), ("-1", None), ("a", None), ("0-9999999", None)],
)
def test_a_kernels_list_of_cores(text: str, cores: set[int] | None) -> None:
    assert machine.parse_cores(text) == cores


@pytest.mark.parametrize("text", ["", "x", "\udcff", "1e9999"])
def test_odd_files_are_no_numbers(tmp_path: Path, text: str) -> None:
    files = {name: text.encode("utf-8", "replace").decode() for name in (SLACK, SOURCE, ISOLATED)}
    assert looked(Recorded(tmp_path, files))["machine.timer_slack"].verdict is Verdict.UNKNOWN


def of_disk(recorded: Recorded, out: Path, duration_s: float = 20.0) -> dict[str, Check]:
    return {check.id: check for check in disk.checks(recorded, out, duration_s, 1e-3, 1)}


@pytest.mark.parametrize(
    ("free_bytes", "verdict"),
    [(20_000_001, Verdict.OK), (19_999_999, Verdict.WARN), (9_999_999, Verdict.FAIL), (0, Verdict.FAIL)],
)
def test_a_disk_has_room_for_what_a_run_writes(tmp_path: Path, free_bytes: int, verdict: Verdict) -> None:
    recorded = Recorded(tmp_path)
    recorded.left = Space(free_bytes, True)
    check = of_disk(recorded, tmp_path)["disk.space"]
    assert check.verdict is verdict
    assert bool(check.remedy) == (verdict is not Verdict.OK)


def test_a_folder_that_can_not_be_written_to_fails_and_none_is_made(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.left = Space(10**12, False)
    out = tmp_path / "not" / "there"
    check = of_disk(recorded, out)["disk.folder"]
    assert check.verdict is Verdict.FAIL
    assert str(tmp_path) in check.text
    assert not out.parent.exists()
    recorded.left = Space(10**12, True)
    assert of_disk(recorded, out)["disk.folder"].verdict is Verdict.OK
    recorded.left = None
    assert of_disk(recorded, out)["disk.folder"].verdict is Verdict.UNKNOWN
    assert of_disk(recorded, Path("/dev/null/x"))["disk.folder"].verdict is Verdict.UNKNOWN
    assert of_disk(recorded, Path("n" * 5000))["disk.folder"].verdict is Verdict.UNKNOWN


def test_this_machine_is_read_without_privileges(tmp_path: Path) -> None:
    system = System()
    assert isinstance(system.scheduling()[0], int)
    assert system.cores()
    assert system.clock_status().max_error_s >= 0.0
    assert system.space(str(tmp_path)).free_bytes > 0
    assert system.run((sys.executable, "-c", "print('said')")).strip() == "said"
    with pytest.raises(OSError, match="exit code 3"):
        system.run((sys.executable, "-c", "raise SystemExit(3)"))
    with pytest.raises(OSError, match="No such file"):
        system.run(("/no/such/command",))
    with pytest.raises(OSError, match="null byte"):
        system.run((sys.executable, "a\0b"))
    with pytest.raises(OSError, match="no file has such a name"):
        system.text("/sys/\0")
    (tmp_path / "long").write_bytes(b"\xff" * (MAX_READ_BYTES + 10))
    assert len(System(tmp_path).text("/long")) == MAX_READ_BYTES
    with pytest.raises(FileNotFoundError):
        system.may_open(str(tmp_path / "none"))
    assert system.may_open(str(tmp_path / "long"))
    assert system.target(str(tmp_path)) == str(tmp_path.resolve())
    assert system.names(str(tmp_path)) == ["long"]
