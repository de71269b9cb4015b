"""The python-can interface where things go wrong: options, full queues, bus-off, frames that it doesn't carry."""

import errno
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from firmware_protocol.frames import Frame
from tests.unit.virtual_bus.clockwork import MS, ROOT, Clockwork, Mute, message
from virtual_bus import worlds
from virtual_bus.interface import VirtualForcepsBus


@pytest.fixture
def bus() -> Iterator[VirtualForcepsBus]:
    with VirtualForcepsBus("unit", nodes=[Clockwork()]) as handle:
        yield handle


def state_of(handle: VirtualForcepsBus) -> can.BusState:
    return handle.state


def test_a_channel_without_a_world_or_with_another_one(bus: VirtualForcepsBus) -> None:
    with pytest.raises(can.CanInitializationError, match="rig="):
        VirtualForcepsBus("nowhere")
    with pytest.raises(can.CanInitializationError, match="already has a world"):
        VirtualForcepsBus("unit", nodes=[Clockwork()])
    assert worlds.channels() == ["unit"]
    assert bus.recv() is not None


@pytest.mark.parametrize(
    "options",
    [
        {"rigg": "x"},
        {"nodes": [], "rig": "x"},
        {"transmit_queue": "0", "nodes": []},
        {"receive_queue": 0, "nodes": []},
        {"nodes": [], "seed": "one"},
        {"nodes": [], "fd": "maybe"},
        {"faults": [{"fault": "drop"}]},
    ],
)
def test_wrong_options_are_refused_and_leave_nothing_behind(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        VirtualForcepsBus("wrong", **options)  # type: ignore[arg-type]
    assert worlds.channels() == []


@pytest.mark.parametrize("options", [{"rig": "no/such/rig.yaml"}, {"nodes": [], "faults": [{"fault": "boom"}]}])
def test_what_can_not_be_opened_is_an_initialization_error(options: dict[str, object]) -> None:
    with pytest.raises(can.CanInitializationError, match=r"rig\.yaml|boom"):
        VirtualForcepsBus("wrong", **options)  # type: ignore[arg-type]
    assert worlds.channels() == []


def test_numbers_may_come_as_strings() -> None:
    with VirtualForcepsBus(
        "strings", nodes=[Clockwork()], seed="4", fd="true", transmit_queue="2", bitrate="500000"
    ) as handle:
        first = handle.recv(timeout=0.01)
        assert first is not None
        assert first.timestamp > 1.2e-3  # twice as long on the wire
        assert handle.protocol is can.CanProtocol.CAN_FD


def test_full_queue_at_once_and_with_patience() -> None:
    with VirtualForcepsBus("full", nodes=[Clockwork()], transmit_queue=2) as handle:
        handle.send(message(0x50, bytes(8)))
        handle.send(message(0x51, bytes(8)))
        with pytest.raises(can.CanOperationError) as caught:
            handle.send(message(0x52))
        assert caught.value.error_code == errno.ENOBUFS
        assert state_of(handle) is can.BusState.ACTIVE
        with pytest.raises(can.CanTimeoutError):
            handle.send(message(0x52), timeout=50e-6)
        handle.send(message(0x52), timeout=500e-6)
        assert handle.counters()["rejected_full"] > 0
        assert handle.send_frame(Frame(0x53, b"")) is False


def test_bus_off_and_recovery_show() -> None:
    faults = [{"fault": "bus_off", "node": "host", "from_s": 0.01, "to_s": 0.02}]
    with VirtualForcepsBus("off", nodes=[Clockwork()], faults=faults) as handle:
        handle.advance_until_ns(15 * MS)
        assert state_of(handle) is can.BusState.ERROR
        with pytest.raises(can.CanOperationError) as caught:
            handle.send(message(0x41))
        assert caught.value.error_code == errno.ENETDOWN
        assert handle.send_frame(Frame(0x41, b"")) is False
        # The drive, alone, repeats what nobody acknowledges: each attempt is one of the 128 sequences.
        handle.advance_until_ns(25 * MS)
        assert state_of(handle) is can.BusState.ERROR
        handle.advance_until_ns(45 * MS)
        assert state_of(handle) is can.BusState.ACTIVE
        handle.send(message(0x41))
        assert handle.counters()["bus_offs"] == 1


def test_error_passive_shows() -> None:
    faults = [{"fault": "corrupt_wire", "id": 0x41, "count": 17}]
    with VirtualForcepsBus("passive", nodes=[Mute()], faults=faults) as handle:
        handle.send(message(0x41))
        handle.advance_until_ns(10 * MS)
        assert handle.counters()["tec"] == 17 * 8 - 1
        assert state_of(handle) is can.BusState.PASSIVE


def test_bus_gone_is_an_error_that_costs_the_wait() -> None:
    faults = [{"fault": "bus_gone", "from_s": 0.01, "to_s": 0.02}]
    with VirtualForcepsBus("gone", nodes=[Clockwork()], faults=faults) as handle:
        handle.advance_until_ns(10 * MS)
        while handle.recv(timeout=0):
            pass
        with pytest.raises(can.CanOperationError) as caught:
            handle.recv(timeout=0.005)
        assert caught.value.error_code == errno.ENODEV
        assert handle.now_ns() == 15 * MS
        assert state_of(handle) is can.BusState.ERROR
        with pytest.raises(can.CanOperationError) as caught:
            handle.send(message(0x41))
        assert caught.value.error_code == errno.ENODEV
        with pytest.raises(can.CanOperationError):
            handle.recv(timeout=0.006)
        assert handle.recv(timeout=0.002) is not None


@pytest.mark.parametrize(
    "wrong",
    [
        message(0x41, is_remote_frame=True),
        message(0x41, is_error_frame=True),
        message(0x41, bytes(12), is_fd=True),
    ],
)
def test_frames_this_bus_does_not_carry(bus: VirtualForcepsBus, wrong: can.Message) -> None:
    with pytest.raises(can.CanOperationError) as caught:
        bus.send(wrong)
    assert caught.value.error_code == errno.EINVAL


def test_channels_in_use_are_found(bus: VirtualForcepsBus) -> None:
    assert can.detect_available_configs([]) == []
    assert VirtualForcepsBus._detect_available_configs() == [{"interface": "virtual_forceps", "channel": "unit"}]
    assert bus.channel_info.endswith("unit")


def test_python_can_finds_it_by_name(tmp_path: Path) -> None:
    """In a process of its own, with the entry points of pyproject.toml as an installed package has them."""
    import tomllib  # noqa: PLC0415

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    info = tmp_path / "forceps_entry-0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: forceps-entry\nVersion: 0\n")
    entries = project["entry-points"]["can.interface"]
    (info / "entry_points.txt").write_text("[can.interface]\n" + "\n".join(f"{k} = {v}" for k, v in entries.items()))
    program = (
        "import can\n"
        "rig = 'configs/paper.yaml'\n"
        "bus = can.Bus(interface='virtual_forceps', channel='bench', rig=rig, simulation='1', seed='2')\n"
        "first = bus.recv(1.0)\n"
        "print(type(bus).__name__, first.arbitration_id & 31, bus.now_ns() < 10**9)\n"
        "bus.shutdown()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.stdout.split() == ["VirtualForcepsBus", "1", "True"], done.stderr


def test_a_load_by_points_goes_before_the_papers() -> None:
    rig = ROOT / "configs" / "paper.yaml"
    with VirtualForcepsBus("load", rig=rig, simulation=2, load=[(0.0, 1e-3), (1.0, 0.0)], truth_duration_s=0.05) as bus:
        bus.advance_until_ns(40 * MS)
        # It begins with the first sample in operation: until then the first torque holds.
        assert set(bus.truth_log().columns()["tau_w_N_m"]) == {1e-3}
        with pytest.raises(can.CanInitializationError, match="already has a world made of something else"):
            VirtualForcepsBus("load", rig=rig, simulation=2)
    for points, said in (
        ([], "at least one"),
        ([(1.0, 0.0), (0.0, 0.0)], "not decrease"),
        ([(0.0, float("nan"))], "fin"),
    ):
        with pytest.raises(can.CanInitializationError, match=said):
            VirtualForcepsBus("load", rig=rig, load=points)
