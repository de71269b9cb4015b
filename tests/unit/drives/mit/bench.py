"""A mini cheetah drive's machine in ticks of 1 ms, with answers made by hand."""

from collections.abc import Callable

from firmware_protocol.frames import Frame
from firmware_protocol.states import HostPhase
from hil_forceps.drives.mit import messages as wire
from hil_forceps.drives.mit.machine import Mit, MitConfig
from hil_forceps.drives.mit.messages import Codes, Ranges, Special

NODE, MS = 5, 1_000_000
RANGES = Ranges(12.5, 50.0, 500.0, 5.0, 18.0)
CONFIG = MitConfig(NODE, 0, "bgkatz", RANGES, 20.0, 10.0, 1.0, 1.0, 0.0, MS, 3 * MS)
DAMIAO = CONFIG._replace(variant="damiao", reply_id=0x15)
POSITION = 40_000
DISABLED, ENABLED, OVER_CURRENT = 0x0, 0x1, 0xA
EXIT, ENTER = wire.special(NODE, Special.EXIT), wire.special(NODE, Special.ENTER)
Answers = Callable[[Frame], Frame | None]


def answer(position: int = POSITION, torque: int = 2047, extra: bytes = b"\xff", reply_id: int = 0) -> Frame:
    packed = position << 24 | 2047 << 12 | torque
    return Frame(reply_id, bytes((NODE,)) + packed.to_bytes(5, "big") + extra)


def damiao(status: int, position: int = POSITION) -> Frame:
    return Frame(0x15, bytes((status << 4 | NODE,)) + answer(position).data[1:6] + bytes((25, 25)))


class Motor:
    """A DaMiao: enters, leaves, and says so; the answer is of before the order."""

    def __init__(self) -> None:
        self.status = DISABLED

    def __call__(self, frame: Frame) -> Frame | None:
        reply = damiao(self.status)
        special = wire.special_of(frame.data)
        if special is Special.CLEAR_ERRORS or (special is Special.EXIT and self.status == ENABLED):
            self.status = DISABLED
        elif special is Special.ENTER and self.status == DISABLED:
            self.status = ENABLED
        return reply


def ticks(
    drive: Mit, first_ms: int, count: int, raw: int | None = 0, answers: Answers = lambda _: answer()
) -> list[list[Frame]]:
    """What goes out in some ticks, as the service asks for it; each frame is answered half a tick later."""
    sent = []
    for now_ms in range(first_ms, first_ms + count):
        reference = None if raw is None else drive.setpoint(raw)
        frames = [] if reference is None else [reference]
        frames += drive.poll(now_ms * MS)
        sent.append(frames)
        for frame in frames:
            reply = answers(frame)
            if reply is not None:
                drive.receive(reply, now_ms * MS + MS // 2)
    return sent


def ready(config: MitConfig = CONFIG, answers: Answers = lambda _: answer()) -> Mit:
    drive = Mit(config)
    drive.connect(0)
    ticks(drive, 1, 15, answers=answers)
    assert drive.phase is HostPhase.READY
    return drive


def running(config: MitConfig = CONFIG, answers: Answers = lambda _: answer()) -> Mit:
    """At 56 ms."""
    drive = ready(config, answers)
    drive.enable()
    ticks(drive, 16, 40, answers=answers)
    assert drive.phase is HostPhase.RUNNING
    drive.take_samples()
    return drive


def codes(frame: Frame) -> Codes:
    found = wire.parse_command(frame.data)
    assert found is not None
    return found


def nobody(_: Frame) -> None:
    return None
