"""What holds on the virtual bus whatever is sent."""

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from virtual_bus.bus.bit_timing import BitTiming, frame_bits, frame_bits_bounds
from virtual_bus.bus.faults import FOREVER_NS, FaultInjector, FaultKind, Side, parse_faults
from virtual_bus.bus.medium import Medium
from virtual_bus.bus.simulation import Simulation

FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
IDS = st.tuples(st.integers(0, 0x7FF), st.just(False)) | st.tuples(st.integers(0, 0x1FFFFFFF), st.just(True))
RUNS = st.sampled_from([b"\x00", b"\xff", b"\xf0", b"\x0f", b"\x3c", b"\x55"])


def payloads(length: int) -> st.SearchStrategy[bytes]:
    return st.binary(min_size=length, max_size=length) | RUNS.map(lambda byte: byte * length)


def frames(lengths: st.SearchStrategy[int], is_fd: bool) -> st.SearchStrategy[Frame]:
    made = st.tuples(IDS, lengths.flatmap(payloads))
    return made.map(lambda drawn: Frame(drawn[0][0], drawn[1], is_fd, drawn[0][1]))


CLASSIC = frames(st.integers(0, 8), False)
FD = frames(st.sampled_from(FD_LENGTHS), True)


def stuff_bits(bits: str) -> int:
    """Count stuff bits by inserting them."""
    out, count = "", 0
    for bit in bits:
        out += bit
        if out[-5:] in ("00000", "11111"):
            out += "10"[int(bit)]
            count += 1
    return count


def crc15(bits: str) -> str:
    register = 0
    for bit in bits:
        register = (register << 1) ^ (0x4599 if (register >> 14 & 1) ^ int(bit) else 0)
        register &= 0x7FFF
    return format(register, "015b")


def binary(data: bytes) -> str:
    return "".join(format(byte, "08b") for byte in data)


def written_id(frame: Frame) -> str:
    """Write SOF and all up to and with RTR (RRS): for an extended frame SRR and IDE stand amid the id."""
    if not frame.is_extended:
        return f"0{frame.arbitration_id:011b}0"
    bits = f"{frame.arbitration_id:029b}"
    return f"0{bits[:11]}11{bits[11:]}0"


@given(CLASSIC)
@settings(max_examples=300)
def test_classic_bits_equal_the_reference(frame: Frame) -> None:
    body = f"{written_id(frame)}00{len(frame.data):04b}{binary(frame.data)}"  # IDE, r0 or r1, r0
    body += crc15(body)
    assert frame_bits(frame) == (len(body) + stuff_bits(body) + 10, 0)


@given(FD)
@settings(max_examples=300)
def test_fd_bits_equal_the_reference(frame: Frame) -> None:
    length = len(frame.data)
    dlc = FD_LENGTHS.index(length)
    head = written_id(frame) + ("101" if frame.is_extended else "0101")  # IDE of a base frame; FDF, res, BRS
    # A stuff bit behind the last bit of the head is already fast; behind the data there is a fixed one anyway.
    whole = f"{head}0{dlc:04b}{binary(frame.data)}"
    in_head = stuff_bits(head[:-1])
    in_all = stuff_bits(whole[:-1])
    crc = 4 + (17 + 6 if length <= 16 else 21 + 7)
    assert frame_bits(frame) == (len(head) + 9 + in_head, 5 + 8 * length + crc + 1 + in_all - in_head)


@given(CLASSIC | FD)
@settings(max_examples=300)
def test_bits_stay_within_their_bounds(frame: Frame) -> None:
    fewest, most = frame_bits_bounds(len(frame.data), frame.is_fd, frame.is_extended)
    bits = frame_bits(frame)
    assert fewest.nominal <= bits.nominal <= most.nominal
    assert fewest.nominal + fewest.data <= bits.nominal + bits.data <= most.nominal + most.data
    timing = BitTiming()
    longest_ns = timing.bits_ns(most.nominal) + most.data * 200
    assert timing.bits_ns(fewest.nominal) + fewest.data * 200 <= timing.frame_ns(frame) <= longest_ns


class Sender:
    """Sends its frames at their times; ids are its own, so nobody clashes."""

    def __init__(self, schedule: list[tuple[int, Frame]]) -> None:
        self.schedule = sorted(schedule, key=lambda item: item[0])
        self.outbox: list[Frame] = []
        self.heard: list[tuple[int, Frame]] = []

    def receive(self, frame: Frame, now_ns: int) -> None:
        self.heard.append((now_ns, frame))

    def next_wake_ns(self) -> int:
        return self.schedule[0][0] if self.schedule else FOREVER_NS

    def wake(self, now_ns: int) -> None:
        while self.schedule and self.schedule[0][0] <= now_ns:
            self.outbox.append(self.schedule.pop(0)[1])

    def take_outbox(self) -> list[Frame]:
        frames, self.outbox = self.outbox, []
        return frames


def schedules(function: int) -> st.SearchStrategy[list[tuple[int, Frame]]]:
    frame = st.builds(
        Frame,
        st.integers(0, 31).map(lambda node: function << 5 | node),
        st.binary(max_size=8),
        st.just(False),
        st.booleans(),
    )
    return st.lists(st.tuples(st.integers(0, 5_000_000), frame), max_size=25)


def faults_of(kind: str, **keys: object) -> st.SearchStrategy[dict[str, object]]:
    chance = st.floats(0.0, 1.0)
    return chance.map(lambda probability: {"fault": kind, "probability": probability, **keys})


def windows(kind: str, **keys: object) -> st.SearchStrategy[dict[str, object]]:
    return st.floats(0.0, 2e-3).map(lambda from_s: {"fault": kind, "from_s": from_s, "to_s": 3e-3, **keys})


FAULTS = st.lists(
    st.one_of(
        *(faults_of(kind) for kind in ("drop", "duplicate", "reorder", "corrupt_payload")),
        faults_of("corrupt_wire", count=7),
        faults_of("delay", delay_s=1.3e-3),
        windows("bus_off", node="drive"),
        windows("bus_gone"),
    ),
    max_size=4,
)


def run(
    schedules_: list[list[tuple[int, Frame]]], faults: list[dict[str, object]]
) -> tuple[Simulation, list[Sender], FaultInjector]:
    injector = FaultInjector(parse_faults(faults), 5)
    simulation = Simulation(Medium(BitTiming(), injector if faults else None))
    senders = [Sender(schedule) for schedule in schedules_]
    for index, sender in enumerate(senders):
        simulation.add(sender, f"s{index}", Side.HOST if index == 0 else Side.DRIVE)
    simulation.advance_until(60_000_000)
    return simulation, senders, injector


THREE = st.tuples(schedules(1), schedules(2), schedules(3)).map(list)


@given(THREE)
@settings(max_examples=60)
def test_without_faults_every_accepted_frame_reaches_everybody_else_once_and_in_order(
    plan: list[list[tuple[int, Frame]]],
) -> None:
    simulation, senders, _ = run(plan, [])
    ports = simulation.medium.ports
    for index, (sender, port) in enumerate(zip(senders, ports, strict=True)):
        assert port.sent + port.rejected_full == len(plan[index])
        assert port.queued == 0
        others = sum(other.sent for other in ports if other is not port)
        assert len(sender.heard) == port.received == others
        times = [time_ns for time_ns, _ in sender.heard]
        # No two frames overlap on the wire: each ends at least its own length and an intermission after the last.
        for before, (after, frame) in zip(times, sender.heard[1:], strict=False):
            assert after - before >= (frame_bits(frame).nominal + 3) * 1000


@given(THREE, FAULTS)
@settings(max_examples=60)
def test_the_same_seed_gives_the_same_bus_and_every_frame_is_accounted_for(
    plan: list[list[tuple[int, Frame]]], faults: list[dict[str, object]]
) -> None:
    simulation, senders, injector = run(plan, faults)
    again = run(plan, faults)
    assert [sender.heard for sender in senders] == [sender.heard for sender in again[1]]
    ports = simulation.medium.ports
    for index, port in enumerate(ports):
        fates = port.sent + port.rejected_full + port.rejected_down + port.discarded + port.queued
        assert fates == len(plan[index])
        assert port.tec < 256
    changing = {FaultKind.DROP, FaultKind.DUPLICATE, FaultKind.REORDER, FaultKind.BUS_OFF, FaultKind.BUS_GONE}
    if not changing & {fault["fault"] for fault in faults}:
        # Only delays and corruption: as many frames as were sent, and the same ids.
        for port, sender in zip(ports, senders, strict=True):
            assert port.received == sum(other.sent for other in ports if other is not port)
            assert sum(Counter(frame.arbitration_id for _, frame in sender.heard).values()) == port.received
    assert injector.counters[FaultKind.CORRUPT_WIRE] == 0 or any(port.error_frames for port in ports)
