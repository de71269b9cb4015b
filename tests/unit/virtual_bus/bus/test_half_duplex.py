"""A serial line in virtual time: byte times, order, collisions, full queues, plugs that are pulled."""

from firmware_protocol.frames import Frame
from hil_forceps.drives.dynamixel import packets as wire
from virtual_bus.bus.faults import FaultInjector, Side, parse_faults
from virtual_bus.bus.half_duplex import HalfDuplexLine
from virtual_bus.bus.port import Port
from virtual_bus.bus.simulation import Simulation
from virtual_bus.drives.dynamixel_packets import CODEC

MS = 1_000_000


class Talker:
    """A node that says what it is told to, and notes what it hears."""

    def __init__(self, says: list[tuple[int, Frame]]) -> None:
        self.says = says
        self.heard: list[tuple[int, Frame]] = []

    def receive(self, frame: Frame, now_ns: int) -> None:
        self.heard.append((now_ns, frame))

    def next_wake_ns(self) -> int:
        return self.says[0][0] if self.says else 1 << 60

    def wake(self, now_ns: int) -> None:
        self.due = [frame for at_ns, frame in self.says if at_ns <= now_ns]
        self.says = [each for each in self.says if each[0] > now_ns]

    def take_outbox(self) -> list[Frame]:
        due, self.due = getattr(self, "due", []), []
        return due


def test_the_line_takes_ten_bits_a_byte_and_keeps_a_senders_order() -> None:
    line = HalfDuplexLine(CODEC, 1_000_000)
    simulation = Simulation(line)
    first, second = Talker([(0, wire.read(9, 0, 2)), (0, wire.ping(1))]), Talker([])
    for node in (first, second):
        simulation.add(node, "talker", Side.HOST)
    simulation.advance_until(MS)
    assert second.heard == [(140_000, wire.read(9, 0, 2)), (240_000, wire.ping(1))]
    assert line.collisions == 0


def test_two_that_talk_at_once_are_not_understood() -> None:
    line = HalfDuplexLine(CODEC, 1_000_000)
    simulation = Simulation(line)
    first, second = Talker([(0, wire.ping(1)), (MS, wire.ping(3))]), Talker([(50_000, wire.ping(2))])
    for node in (first, second):
        simulation.add(node, "talker", Side.HOST)
    simulation.advance_until(2 * MS)
    assert first.heard == []
    assert second.heard == [(MS + 100_000, wire.ping(3))]
    assert line.collisions == 2


def two(line: HalfDuplexLine, *says: tuple[int, Frame]) -> tuple[Simulation, Talker, Talker, Port]:
    simulation = Simulation(line)
    host, servo = Talker(list(says)), Talker([])
    port = simulation.add(host, "host", Side.HOST, 2)
    simulation.add(servo, "servo", Side.DRIVE)
    return simulation, host, servo, port


def faulty(*schedule: dict[str, object]) -> HalfDuplexLine:
    return HalfDuplexLine(CODEC, 1_000_000, FaultInjector(parse_faults(schedule), 1))


def test_a_queue_that_is_full_takes_no_more() -> None:
    line = HalfDuplexLine(CODEC, 1_000_000)
    simulation, _, servo, port = two(line, *((0, wire.ping(n)) for n in range(5)))
    simulation.advance_until(MS)
    assert [frame.arbitration_id for _, frame in servo.heard] == [0, 1]
    assert port.rejected_full == 3
    assert port.queued == 0


def test_what_is_flushed_was_not_begun() -> None:
    line = HalfDuplexLine(CODEC, 1_000_000)
    simulation, _, servo, port = two(line, (0, wire.ping(1)), (0, wire.ping(2)))
    simulation.advance_until(50_000)
    line.flush(port)
    simulation.advance_until(MS)
    assert [frame.arbitration_id for _, frame in servo.heard] == [1]
    assert (port.queued, port.discarded) == (0, 1)


def test_a_node_that_leaves_hears_nothing_more() -> None:
    line = HalfDuplexLine(CODEC, 1_000_000)
    simulation, _, servo, port = two(line, (0, wire.ping(1)))
    simulation.advance_until(50_000)
    simulation.remove(port)
    simulation.advance_until(MS)
    assert [frame.arbitration_id for _, frame in servo.heard] == [1]  # it was on the line
    assert [each.name for each in line.ports] == ["servo"]


def test_a_plug_that_is_pulled_cuts_one_side_and_may_be_put_back() -> None:
    line = faulty({"fault": "bus_off", "node": "drive", "from_s": 1.05e-3, "to_s": 3.5e-3})
    says = [(n * MS, wire.ping(n)) for n in range(1, 6)]
    simulation, _, servo, port = two(line, *says)
    simulation.advance_until(10 * MS)
    assert [frame.arbitration_id for _, frame in servo.heard] == [4, 5]
    assert port.rejected_down == 0


def test_a_line_that_is_gone_takes_and_brings_nothing() -> None:
    line = faulty({"fault": "bus_gone", "from_s": 1.05e-3, "to_s": 3.5e-3})
    says = [(n * MS, wire.ping(n)) for n in range(1, 6)]
    simulation, _, servo, port = two(line, *says)
    simulation.advance_until(2 * MS)
    assert line.gone
    simulation.advance_until(10 * MS)
    assert [frame.arbitration_id for _, frame in servo.heard] == [4, 5]
    assert (port.rejected_down, port.discarded, port.queued) == (2, 1, 0)


def test_packets_are_lost_damaged_and_late_by_schedule() -> None:
    line = faulty(
        {"fault": "drop", "direction": "to_drive", "from_s": 0.9e-3, "to_s": 1.5e-3},
        {"fault": "corrupt_wire", "direction": "to_drive", "from_s": 1.9e-3, "to_s": 2.5e-3},
        {"fault": "delay", "direction": "to_drive", "delay_s": 5.0e-3, "from_s": 2.9e-3, "to_s": 3.5e-3},
    )
    simulation, _, servo, _ = two(line, *((n * MS, wire.ping(n)) for n in range(1, 4)))
    simulation.advance_until(20 * MS)
    assert servo.heard == [(8 * MS + 100_000, wire.ping(3))]
