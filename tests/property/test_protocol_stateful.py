"""Host and drive at the ends of a serial line, with anything on it and any button pressed, as hypothesis likes.

Whatever came before: nothing raises, no buffer grows, torque is by OPERATIONAL only, and once the line is left alone
the two find each other.
"""

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostConfig, HostMachine, HostPhase
from firmware_protocol.host.samples import MAX_PENDING_HALVES, MAX_QUEUED_SAMPLES
from firmware_protocol.messages import DriveState, FaultReason
from firmware_protocol.serial_framing import SerialReader, encode_serial

NODE, SERIAL = 1, 0x5F0C_0000_0001
LONGEST_PACKET = 69
MS = 1_000_000
CONNECT_MS = 2_000
LENGTHS = (1, LONGEST_PACKET - 1, LONGEST_PACKET, LONGEST_PACKET + 1, 3 * LONGEST_PACKET)
ANGLES = st.integers(-(1 << 31), (1 << 31) - 1)


class Ends(RuleBasedStateMachine):
    """`noise` stands on the line before the next frames, each way."""

    def __init__(self) -> None:
        super().__init__()
        self.host = HostMachine(HostConfig(node=NODE))
        self.drive = DriveMachine(DriveConfig(NODE, SERIAL))
        self.to_host, self.to_drive = SerialReader(), SerialReader()
        self.noise = {"host": b"", "drive": b""}
        self.now_ns = 0
        self.theta = 0

    @rule(end=st.sampled_from(["host", "drive"]), data=st.binary(max_size=300))
    def disturb(self, end: str, data: bytes) -> None:
        self.noise[end] = data

    @rule(end=st.sampled_from(["host", "drive"]), byte=st.integers(1, 255), count=st.sampled_from(LENGTHS))
    def babble(self, end: str, byte: int, count: int) -> None:
        self.noise[end] = bytes((byte,)) * count
        self.pass_ms(lost=True)

    @rule(
        end=st.sampled_from(["host", "drive"]),
        identifier=st.integers(0, 0x7FF),
        data=st.binary(max_size=8),
        is_fd=st.booleans(),
    )
    def slip_in(self, end: str, identifier: int, data: bytes, is_fd: bool) -> None:
        self.noise[end] = b"\0" + encode_serial(Frame(identifier, data, is_fd))

    @rule(count=st.integers(1, 40), lost=st.booleans())
    def run_on(self, count: int, lost: bool) -> None:
        for _ in range(count):
            self.pass_ms(lost)

    @rule(delay_ms=st.integers(1, 3_000))
    def stand_still(self, delay_ms: int) -> None:
        self.now_ns += delay_ms * MS

    @rule(button=st.sampled_from(["connect", "enable", "disable", "reset_fault"]), theta=ANGLES)
    def press(self, button: str, theta: int) -> None:
        self.theta = theta
        try:
            if button == "connect":
                self.host.connect(self.now_ns)
            else:
                getattr(self.host, button)()
        except ValueError:
            return

    @rule(theta=ANGLES)
    def ask_for_an_angle(self, theta: int) -> None:
        reference = self.host.setpoint(theta)
        if reference is not None:
            self.receive_at_drive(encode_serial(reference))

    @invariant()
    def bounded(self) -> None:
        for reader in (self.to_host, self.to_drive):
            assert len(reader._partial) <= LONGEST_PACKET
        samples = self.host._samples
        assert max(len(samples._queue), len(samples._bench)) <= MAX_QUEUED_SAMPLES
        assert max(len(samples._feedback), len(samples._timing)) <= MAX_PENDING_HALVES

    @invariant()
    def torque_by_operational_only(self) -> None:
        assert (self.drive.reference_raw is not None) == (self.drive.state is DriveState.OPERATIONAL)
        assert (self.drive.fault is not FaultReason.NONE) == (self.drive.state is DriveState.FAULT)

    def teardown(self) -> None:
        for _ in range(CONNECT_MS):
            if self.host.phase in (HostPhase.DISCONNECTED, HostPhase.REFUSED):
                self.host.connect(self.now_ns)
            self.pass_ms(lost=False)
            if self.host.phase in (HostPhase.READY, HostPhase.RUNNING, HostPhase.FAULT):
                return
        raise AssertionError(f"no connection: {self.host.phase}")

    def pass_ms(self, lost: bool) -> None:
        """Let a millisecond pass; `lost`: the last byte each way does not arrive."""
        self.now_ns += MS
        end = -1 if lost else None
        sent = b"".join(map(encode_serial, self.host.poll(self.now_ns)))
        answers = self.receive_at_drive(self.noise["drive"] + sent[:end])
        now_us = self.now_ns // 1000
        frames = answers + self.drive.poll(now_us) + self.drive.sample(now_us, self.theta, 0)
        back = b"".join(map(encode_serial, frames))
        for frame in self.to_host.feed(self.noise["host"] + back[:end]):
            self.host.receive(frame, self.now_ns)
        self.noise = {"host": b"", "drive": b""}
        self.bounded()

    def receive_at_drive(self, data: bytes) -> list[Frame]:
        now_us = self.now_ns // 1000
        return [a for frame in self.to_drive.feed(data) for a in self.drive.receive(frame, now_us, self.theta)]


def run(machine: type[Ends], phases: tuple[Phase, ...] = tuple(Phase)) -> None:
    run_state_machine_as_test(machine, settings=settings(max_examples=60, stateful_step_count=30, phases=phases))


def test_whatever_happens_they_find_each_other() -> None:
    run(Ends)


class Hoarder(SerialReader):
    """Keeps what it should skip."""

    def feed(self, data: bytes) -> list[Frame]:
        frames = super().feed(data)
        if self._skipping:
            self._partial += data
        return frames


class Lost(SerialReader):
    """Does not find its place again after bytes that are no COBS."""

    def feed(self, data: bytes) -> list[Frame]:
        frames = super().feed(data)
        return [] if self.counters["bad_cobs"] else frames


@pytest.mark.parametrize("reader", [Hoarder, Lost])
def test_what_is_broken_is_found(reader: type[SerialReader]) -> None:
    class Broken(Ends):
        def __init__(self) -> None:
            super().__init__()
            self.to_drive = reader()

    with pytest.raises(AssertionError):
        run(Broken, (Phase.generate,))  # that there is an example is enough; the least one takes long
