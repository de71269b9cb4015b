"""A SocketCAN device, by recorded answers of `ip -details -statistics -json link show` and by sysfs."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_forceps.bridge.doctor import can_interface
from hil_forceps.bridge.doctor.can_state import CanState, parse
from hil_forceps.bridge.doctor.check import Check, Verdict
from hil_forceps.rig.sections import BenchSettings, Limits
from tests.recorded_machine import Recorded

CLASSIC, FD = BenchSettings(), BenchSettings(transport="fd")


def link(**changed: Any) -> list[dict[str, Any]]:
    """Return the answer of a healthy device, with parts of its `info_data` changed; the fields of iproute2 6.1."""
    data = {
        "state": "ERROR-ACTIVE",
        "berr_counter": {"tx": 0, "rx": 0},
        "restart_ms": 0,
        "bittiming": {"bitrate": 1000000, "sample_point": "0.750", "tq": 62, "prop_seg": 5, "sjw": 1, "brp": 5},
        "bittiming_const": {"name": "mcp251xfd", "tseg1": {"min": 2, "max": 256}},
        "clock": 40000000,
    }
    return [
        {
            "ifindex": 3, "ifname": "can0", "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"], "mtu": 16,
            "qdisc": "pfifo_fast", "operstate": "UP", "txqlen": 10, "link_type": "can",
            "linkinfo": {"info_kind": "can", "info_data": {**data, **changed}, "info_xstats": {"bus_off": 0}},
        }
    ]  # fmt: skip


def looked(
    root: Path, said: list[dict[str, Any]] | str | None, bench: BenchSettings | None = CLASSIC
) -> dict[str, Check]:
    recorded = Recorded(root)
    recorded.said = json.dumps(said) if isinstance(said, list) else said
    return {check.id: check for check in can_interface.checks(recorded, "can0", bench, Limits())}


def test_a_healthy_device_is_well(tmp_path: Path) -> None:
    found = looked(tmp_path, link())
    assert set(found) == {
        "can.up", "can.bit_rate", "can.sample_point", "can.state", "can.errors", "can.restart", "can.queue",
    }  # fmt: skip
    assert {check.verdict for check in found.values()} == {Verdict.OK}


def test_a_healthy_fd_device_is_well(tmp_path: Path) -> None:
    said = link(ctrlmode=["FD", "TDC_AUTO"], data_bittiming={"bitrate": 5000000, "sample_point": "0.750"})
    assert {check.verdict for check in looked(tmp_path, said, FD).values()} == {Verdict.OK}


@pytest.mark.parametrize(
    ("changed", "name", "verdict", "text", "remedy"),
    [
        (
            {"bittiming": {"bitrate": 500000, "sample_point": 0.875}},
            "can.bit_rate",
            Verdict.FAIL,
            "500 kbit/s, the rig has 1000 kbit/s",
            "sudo ip link set can0 down; sudo ip link set can0 up type can bitrate 1000000",
        ),
        (
            {"bittiming": {"bitrate": 1000000, "sample_point": "0.600"}},
            "can.sample_point",
            Verdict.WARN,
            "60 %",
            "0.875",
        ),
        ({"state": "BUS-OFF"}, "can.state", Verdict.FAIL, "BUS-OFF", "sudo ip link set can0 down"),
        ({"state": "STOPPED"}, "can.state", Verdict.FAIL, "STOPPED", "sudo ip link set can0 up"),
        ({"state": "ERROR-PASSIVE"}, "can.state", Verdict.WARN, "ERROR-PASSIVE", "termination"),
        ({"berr_counter": {"tx": 0, "rx": 135}}, "can.errors", Verdict.FAIL, "passive from 128", "candump -e can0"),
        ({"berr_counter": {"tx": 96, "rx": 0}}, "can.errors", Verdict.FAIL, "warning from 96", "candump -e can0"),
        ({"berr_counter": {"tx": 8, "rx": 0}}, "can.errors", Verdict.WARN, "damaged recently", "candump -e can0"),
        ({"restart_ms": 100}, "can.restart", Verdict.WARN, "after 100 ms", "restart-ms 0"),
    ],
)
def test_what_is_wrong_with_a_device_is_told_with_a_line_to_type(
    tmp_path: Path, changed: dict[str, Any], name: str, verdict: Verdict, text: str, remedy: str
) -> None:
    check = looked(tmp_path, link(**changed))[name]
    assert check.verdict is verdict
    assert text in check.text
    assert remedy in check.remedy


def test_a_device_that_is_down_fails(tmp_path: Path) -> None:
    said = link(state="STOPPED")
    said[0]["flags"] = ["NOARP", "ECHO"]
    check = looked(tmp_path, said)["can.up"]
    assert check.verdict is Verdict.FAIL
    assert "up type can bitrate 1000000" in check.remedy


def test_a_queue_longer_than_a_sample_may_be_old_is_warned_of(tmp_path: Path) -> None:
    said = link()
    said[0]["txqlen"] = 23  # of 135 µs each: 3.1 ms, where 3 ms are allowed
    assert looked(tmp_path, said)["can.queue"].verdict is Verdict.WARN
    said[0]["txqlen"] = 22
    assert looked(tmp_path, said)["can.queue"].verdict is Verdict.OK


def test_an_fd_rig_on_a_classic_device_fails(tmp_path: Path) -> None:
    check = looked(tmp_path, link(), FD)["can.data_bit_rate"]
    assert check.verdict is Verdict.FAIL
    assert "bitrate 1000000 dbitrate 5000000 fd on" in check.remedy
    said = link(ctrlmode=["FD"], data_bittiming={"bitrate": 2000000, "sample_point": "0.750"})
    assert looked(tmp_path, said, FD)["can.data_bit_rate"].verdict is Verdict.FAIL


def test_a_device_that_was_bus_off_is_warned_of(tmp_path: Path) -> None:
    said = link()
    said[0]["linkinfo"]["info_xstats"]["bus_off"] = 2
    check = looked(tmp_path, said)["can.state"]
    assert (check.verdict, check.text) == (Verdict.WARN, "ERROR-ACTIVE, 2 times bus-off since it came up")


def test_vcan_has_no_controller(tmp_path: Path) -> None:
    said = link()
    said[0]["linkinfo"] = {"info_kind": "vcan"}
    found = looked(tmp_path, said)
    assert set(found) == {"can.up", "can.bit_rate", "can.queue"}
    assert "vcan" in found["can.bit_rate"].text


def test_slcan_of_before_tells_what_it_has(tmp_path: Path) -> None:
    said = link()
    del said[0]["linkinfo"]
    found = looked(tmp_path, said)
    assert found["can.up"].verdict is Verdict.OK
    assert {check.id for check in found.values() if check.verdict is Verdict.UNKNOWN} == {
        "can.bit_rate", "can.sample_point", "can.state", "can.errors", "can.restart",
    }  # fmt: skip


def test_a_rate_that_the_hardware_has_fixed_is_read(tmp_path: Path) -> None:
    said = link(bittiming_bitrate=500000)
    del said[0]["linkinfo"]["info_data"]["bittiming"]
    assert looked(tmp_path, said)["can.bit_rate"].verdict is Verdict.FAIL


def test_without_iproute_sysfs_tells_some(tmp_path: Path) -> None:
    recorded = Recorded(
        tmp_path,
        {
            "/sys/class/net/can0/flags": "0x40080\n",
            "/sys/class/net/can0/type": "280\n",
            "/sys/class/net/can0/tx_queue_len": "10\n",
        },
    )
    found = {check.id: check for check in can_interface.checks(recorded, "can0", None, Limits())}
    assert found["can.up"].verdict is Verdict.FAIL
    assert found["can.queue"].verdict is Verdict.OK
    assert found["can.state"].verdict is Verdict.UNKNOWN
    assert "No such file" in found["can.state"].text
    recorded.put({"/sys/class/net/can0/flags": "0x400c1\n"})
    assert next(can_interface.checks(recorded, "can0", None, Limits())).verdict is Verdict.OK


def test_what_is_no_can_device_or_not_there_fails(tmp_path: Path) -> None:
    said = link()
    said[0]["link_type"] = "loopback"
    assert looked(tmp_path, said)["can.up"].verdict is Verdict.FAIL
    assert "no CAN device can0" in looked(tmp_path, None)["can.up"].text
    recorded = Recorded(tmp_path, {"/sys/class/net/eth0/flags": "0x1003", "/sys/class/net/eth0/type": "1"})
    (check,) = can_interface.checks(recorded, "eth0", None, Limits())
    assert check.verdict is Verdict.FAIL


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from(["state", "berr_counter", "restart_ms", "bittiming", "ctrlmode"]), JSON), JSON)
def test_whatever_iproute_says_nothing_raises(changed: dict[str, Any], other: Any) -> None:
    said = link(**changed)
    said[0].update(flags=other, txqlen=other, link_type=other)
    state = parse(json.dumps(said))
    assert isinstance(state, CanState)
    assert state.sample_point is None or 0.0 < state.sample_point < 1.0
    for text in (json.dumps(other), json.dumps([other])):
        assert parse(text) is None or isinstance(parse(text), CanState)


@pytest.mark.parametrize("text", ["", "[", "[]", "{}", "null", "[" * 100_000, '[{"linkinfo": 1}]'])
def test_what_is_no_answer_is_none(text: str) -> None:
    assert parse(text) is None or parse(text) == CanState()
