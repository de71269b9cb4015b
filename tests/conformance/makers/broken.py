"""The broken drives."""

import math
from typing import Any

from firmware_protocol.frames import Frame
from firmware_protocol.host.samples import RawSample
from tests.conformance.makers.table import Broken, breaks, leads, measures, wrap

RAD = (1 << 24) / (2.0 * math.pi)  # raw
MA = 5  # raw
MS = 1_000_000
BOTH = ("odrive", "cia402")


# -- identity, samples -------------------------------------------------------------------------------------------------


@breaks(10)
def sends_no_current_at_all(b: Broken) -> None:
    b.peer._iq_every = 0


@breaks(10, profiles=("cia402",))
def stays_in_another_mode(b: Broken) -> None:
    def refresh(old: Any) -> None:
        old()
        b.peer.objects[0x6061, 0] = 1

    wrap(b.peer, "_refresh", refresh)


@breaks(20, 100)
def samples_at_half_the_rate(b: Broken) -> None:
    b.peer._encoder_every *= 2
    b.peer._iq_every *= 2


@breaks(20)
def pauses_for_80_ms_before_it_is_enabled(b: Broken) -> None:
    def send(old: Any, command: int, data: bytes) -> None:
        if command == 0x01 or b.peer.modes != (0, 0) or b.peer._loops % 800 > 160 or b.peer._loops < 800:
            old(command, data)

    wrap(b.peer, "_send", send)


@breaks(21, profiles=BOTH)
def stamps_repeat(b: Broken) -> None:
    last: list[RawSample] = []

    def take(old: Any) -> list[RawSample]:
        taken = []
        for sample in old():
            taken.append(sample._replace(stamp_ns=last[0].stamp_ns) if last and sample.sequence % 50 == 0 else sample)
            last[:] = [taken[-1]]
        return taken

    wrap(b.machine, "take_samples", take)


@breaks(22)
def current_is_missing_now_and_then(b: Broken) -> None:
    def send(old: Any, command: int, data: bytes) -> None:
        if command != 0x14 or b.peer._loops % 600 > 8 or b.peer._loops < 600:
            old(command, data)

    wrap(b.peer, "_send", send)


@breaks(22, profiles=("cia402",))
def a_frame_comes_twice_and_cut_short(b: Broken) -> None:
    def send(old: Any, arbitration_id: int, data: bytes) -> None:
        old(arbitration_id, data)
        if b.peer._loops % 200 == 0:
            old(arbitration_id, data[:1])

    wrap(b.peer, "_send", send)


# -- rest, enabling, holding -------------------------------------------------------------------------------------------


@breaks(30, 71, profiles=BOTH)
def current_has_an_offset(b: Broken) -> None:
    measures(b, lambda theta, current, _: (theta, current + 50 * MA))


@breaks(40)
def enables_with_a_kick(b: Broken) -> None:
    leads(b, lambda reference, _, since_ns: reference + round(0.01 * RAD) * (since_ns < 10 * MS))


@breaks(40, profiles=BOTH)
def runs_away_when_enabled(b: Broken) -> None:
    leads(b, lambda _reference, start, _since_ns: start + round(0.2 * RAD))


@breaks(41)
def wanders_under_torque(b: Broken) -> None:
    """By less than a step may be off."""

    def wander(reference: int, _start: int, since_ns: int) -> int:
        return reference + round(0.0032 * RAD * math.sin(2e-9 * math.pi * 2.0 * max(0, since_ns - 250 * MS)))

    leads(b, wander)


# -- motion ------------------------------------------------------------------------------------------------------------


@breaks(50, profiles=BOTH)
def goes_the_other_way(b: Broken) -> None:
    leads(b, lambda reference, start, _: 2 * start - reference)


@breaks(50, profiles=BOTH)
def angle_is_frozen(b: Broken) -> None:
    first: list[int] = []

    def freeze(theta: int, current: int, _has_torque: bool) -> tuple[int, int]:
        first[:] = first or [theta]
        return first[0], current

    measures(b, freeze)


@breaks(51, profiles=BOTH)
def goes_three_fifths_of_the_way(b: Broken) -> None:
    leads(b, lambda reference, start, _: start + round(0.6 * (reference - start)))


@breaks(52, profiles=BOTH)
def current_counts_backwards(b: Broken) -> None:
    measures(b, lambda theta, current, _: (theta, -current))


@breaks(52, profiles=BOTH)
def current_is_always_none(b: Broken) -> None:
    measures(b, lambda theta, _current, _has_torque: (theta, 0))


@breaks(51, 90, position_min_rad=1.0725, position_max_rad=1.105)
def goes_beyond_its_limits(b: Broken) -> None:
    leads(b, lambda reference, start, _: start + round(1.4 * (reference - start)))


@breaks(90, speed_max_rad_per_s=0.4)
def moves_in_jerks(b: Broken) -> None:
    held = [-MS * MS, 0]  # ns of the last jerk since torque began, raw

    def jerk(reference: int, _start: int, since_ns: int) -> int:
        if since_ns < held[0] or since_ns - held[0] >= 20 * MS:
            held[:] = [since_ns, reference]
        return held[1]

    leads(b, jerk)


@breaks(101)
def follows_late(b: Broken) -> None:
    line: list[tuple[int, int]] = []

    def late(reference: int, start: int, since_ns: int) -> int:
        if line and since_ns < line[-1][0]:
            line.clear()
        line.append((since_ns, reference))
        while len(line) > 1 and line[1][0] <= since_ns - 150 * MS:
            del line[0]
        return line[0][1] if line[0][0] <= since_ns - 150 * MS else start

    leads(b, late)


@breaks(100, profiles=BOTH)
def samples_come_in_pairs(b: Broken) -> None:
    calls = [0]

    def take(old: Any) -> list[RawSample]:
        calls[0] += 1
        return old() if calls[0] % 2 else []

    wrap(b.machine, "take_samples", take)


# -- the end of torque -------------------------------------------------------------------------------------------------


@breaks(60, 61)
def watchdog_never_trips(b: Broken) -> None:
    b.peer._watchdog_ns = 0


@breaks(60, 61)
def watchdog_trips_late(b: Broken) -> None:
    b.peer._watchdog_ns *= 3


@breaks(60, profiles=("cia402",))
def watchdog_trips_early(b: Broken) -> None:
    """Its clock runs three times as fast."""

    def loop(old: Any, at_ns: int) -> None:
        if b.peer._host_ns is not None:
            b.peer._host_ns -= 2 * b.peer._period_ns
        old(at_ns)

    wrap(b.peer, "_loop", loop)


@breaks(60, profiles=("cia402",))
def telemetry_feeds_the_watchdog(b: Broken) -> None:
    def sync(old: Any, now_ns: int) -> None:
        b.peer._host_ns = now_ns if b.peer._host_ns is not None else None
        old(now_ns)

    wrap(b.peer, "_sync", sync)


@breaks(61, profiles=("cia402",))
def watchdog_stands_still_without_sync(b: Broken) -> None:
    """It counts 100 SYNCs, where it should count 100 ms."""
    synced = [0]

    def sync(old: Any, now_ns: int) -> None:
        synced[0] = now_ns
        old(now_ns)

    def loop(old: Any, at_ns: int) -> None:
        if b.peer._host_ns is not None and at_ns - synced[0] > 2 * MS:
            b.peer._host_ns += b.peer._period_ns
        old(at_ns)

    wrap(b.peer, "_sync", sync)
    wrap(b.peer, "_loop", loop)


@breaks(62)
def fault_is_not_latched(b: Broken) -> None:
    failed: list[int] = []

    def fail(old: Any, error: int) -> None:
        old(error)
        failed[:] = [b.peer._loops]

    def loop(old: Any, at_ns: int) -> None:
        if failed and b.peer._loops - failed[0] > 300:  # 150 ms
            b.peer.error = 0
        old(at_ns)

    wrap(b.peer, "_fail", fail)
    wrap(b.peer, "_loop", loop)


@breaks(70, 71)
def does_not_disable(b: Broken) -> None:
    def request(old: Any, state: int) -> None:
        if state != 1:
            old(state)

    wrap(b.peer, "_request", request)


@breaks(70, 71, 72, profiles=("cia402",))
def disables_late(b: Broken) -> None:
    """The emergency stop is the same controlword."""
    asked: list[int] = []

    def obey(old: Any, control: int) -> None:
        if control == 0 and b.peer.status == 0x27:
            asked[:] = asked or [b.peer._loops]
            if b.peer._loops - asked[0] < 1400:  # 700 ms
                return
        asked.clear()
        old(control)

    wrap(b.peer, "_obey", obey)


@breaks(71, profiles=BOTH)
def keeps_current_behind_its_word(b: Broken) -> None:
    had_torque = [False]

    def keep(theta: int, current: int, has_torque: bool) -> tuple[int, int]:
        had_torque[0] |= has_torque
        return theta, current + 50 * MA * (had_torque[0] and not has_torque)

    measures(b, keep)


@breaks(72)
def ignores_the_emergency_stop(b: Broken) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> None:
        if frame.arbitration_id & 0x1F != 0x02:
            old(frame, now_ns)

    wrap(b.peer, "receive", receive)


# -- faults ------------------------------------------------------------------------------------------------------------


@breaks(80, profiles=BOTH)
def has_no_words_for_a_fault(b: Broken) -> None:
    words = b.machine.fault_words()
    wrap(b.machine, "fault_words", lambda _: words)


@breaks(81)
def needs_two_resets(b: Broken) -> None:
    resets = [0]

    def receive(old: Any, frame: Frame, now_ns: int) -> None:
        is_reset = frame.arbitration_id & 0x1F == 0x18
        resets[0] += is_reset
        if not is_reset or resets[0] % 2 == 0:
            old(frame, now_ns)

    wrap(b.peer, "receive", receive)


@breaks(81)
def a_reset_gives_torque(b: Broken) -> None:
    def receive(old: Any, frame: Frame, now_ns: int) -> None:
        old(frame, now_ns)
        if frame.arbitration_id & 0x1F == 0x18:
            b.peer.state = 8

    wrap(b.peer, "receive", receive)
