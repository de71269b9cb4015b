"""What every frame of the drive must be, whatever it was sent for: judged as it arrives, all through a run.

Frames can get lost on a real line, so a gap counts against the drive only where gaps are the rule; in virtual time
nothing gets lost and one is enough.
"""

from collections import Counter, deque
from typing import Final

from firmware_protocol import codec
from firmware_protocol.frames import Frame, split_id
from firmware_protocol.layouts import LAYOUTS, Check
from firmware_protocol.messages import BenchSensor, DriveHeartbeat, FdFeedback, Feedback, Function, Message, Timing

MAX_EXAMPLES: Final = 3
MAX_LOSS_SHARE: Final = 0.05  # of sequences out of step that a lossy line may explain
JUMP_US: Final = {
    True: 5_000,
    False: 200_000,
}  # by virtual time: stamp against arrival from one measurement to the next
_MASK32: Final = (1 << 32) - 1


class Monitor:
    """Takes the frames of one drive. `violations` by requirement; `seen` counts messages by function."""

    def __init__(self, virtual_time: bool) -> None:
        self.virtual_time = virtual_time
        self.is_fd = False
        self.seen: Counter[int] = Counter()
        self.violations: dict[int, deque[str]] = {}
        self.counts: Counter[int] = Counter()
        self.lost = 0
        self._decoder = codec.Decoder()
        self._last: dict[int, int] = {}  # sequence by function
        self._steps: Counter[int] = Counter()  # sequences seen, by function
        self._odd: Counter[int] = Counter()  # of those, out of step
        self._stamp: tuple[int, int] | None = None

    def note(self, requirement: int, finding: str) -> None:
        """Keep a finding; only the first few are kept whole."""
        self.counts[requirement] += 1
        kept = self.violations.setdefault(requirement, deque())
        if len(kept) < MAX_EXAMPLES:
            kept.append(finding)

    def message(self, time_ns: int, frame: Frame) -> Message | None:
        """Judge a frame from the drive; return its message even if the check is wrong, None if unreadable."""
        function, node = split_id(frame.arbitration_id)
        layout = LAYOUTS[Function(function)]
        self.seen[function] += 1
        if self.is_fd and function in (Function.FEEDBACK, Function.TIMING):
            self.note(170, f"an FD drive sent {Function(function).name}")
            return None
        message = self._decoder.decode(frame)
        if message is None:
            right_shape = len(frame.data) == layout.length and frame.is_fd == layout.is_fd
            if not right_shape:
                self.note(20, f"{Function(function).name} with {len(frame.data)} bytes, fd {frame.is_fd}")
                return None
            wrong = 31 if layout.check is Check.CRC16 else 30
            self.note(wrong, f"{Function(function).name} {frame.data.hex(' ')} under id {frame.arbitration_id:#05x}")
            message = layout.build(node, frame.data)
        self._judge(time_ns, function, frame, message)
        return message

    def findings(self, requirement: int) -> str:
        """Return what speaks against the drive in this requirement, or nothing."""
        count = self.counts[requirement]
        if not count:
            return ""
        return f"{count} x: " + "; ".join(self.violations[requirement])

    def out_of_step(self, function: int) -> str:
        """Return what speaks against the sequence of one message, or nothing; forgives what a line may lose."""
        odd, steps = self._odd[function], self._steps[function]
        allowed = 0 if self.virtual_time else max(MAX_LOSS_SHARE * steps, 3)
        return f"{odd} of {steps} {Function(function).name} out of step" if odd > allowed else ""

    def restart(self) -> None:
        """Forget where the streams were: the line itself was disturbed."""
        self._last.clear()
        self._stamp = None

    def _judge(self, time_ns: int, function: int, frame: Frame, message: Message) -> None:
        if isinstance(message, Feedback | DriveHeartbeat):
            self._step(function, message.sequence)
        elif isinstance(message, FdFeedback):
            self._step(function, message.sequence)
            if frame.data[13]:
                self.note(23, f"byte 13 of FD_FEEDBACK is {frame.data[13]:#04x}")
            self._advance(time_ns, message.stamp_us)
        elif isinstance(message, Timing):
            self._partner(function, Function.FEEDBACK, message.sequence)
            self._advance(time_ns, message.stamp_us)
        elif isinstance(message, BenchSensor):
            self._partner(function, Function.FD_FEEDBACK if self.is_fd else Function.FEEDBACK, message.sequence)

    def _step(self, function: int, sequence: int) -> None:
        last = self._last.get(function)
        self._last[function] = sequence
        if last is None:
            return
        self._steps[function] += 1
        step = (sequence - last) & 0xFF
        if step != 1:
            self._odd[function] += 1
            self.lost += (step - 1) & 0xFF if function != Function.DRIVE_HEARTBEAT else 0

    def _partner(self, function: int, of: int, sequence: int) -> None:
        """Compare with the measurement that came just before on the same line."""
        expected = self._last.get(of)
        if expected is None:
            return
        self._steps[function] += 1
        if sequence != expected:
            self._odd[function] += 1

    def _advance(self, time_ns: int, stamp_us: int) -> None:
        before, self._stamp = self._stamp, (time_ns, stamp_us)
        if before is None:
            return
        advance_us = ((stamp_us - before[1] + (1 << 31)) & _MASK32) - (1 << 31)
        arrived_us = (time_ns - before[0]) // 1000
        if advance_us <= 0 or abs(advance_us - arrived_us) > JUMP_US[self.virtual_time]:
            self.note(51, f"stamp went by {advance_us} us while {arrived_us} us passed")
