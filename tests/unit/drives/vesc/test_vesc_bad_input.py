"""What comes from outside never raises in the VESC profile; nothing that moves is sent unasked. Wrong calls raise."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from firmware_protocol.states import HostPhase
from hil_forceps.drives.vesc.machine import TRANSITIONS, Vesc
from tests.unit.drives.vesc.bench import CONFIG, HOST, MS, NODE, REQUEST, Bench, answer, command


@pytest.mark.parametrize("call", ["enable", "reset_fault"])
def test_calls_at_the_wrong_time_raise(call: str) -> None:
    with pytest.raises(ValueError, match=r"can't be enabled|no fault"):
        getattr(Vesc(CONFIG), call)()
    with pytest.raises(ValueError, match="connected already"):
        Bench().running().drive.connect(0)


@pytest.mark.parametrize("change", [{"node": 253}, {"node": -1}, {"rev_per_pulley_rev": 0.0}, {"timeout_ns": 0}])
def test_what_is_no_vesc(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="no VESC"):
        Vesc(CONFIG._replace(**change))  # type: ignore[arg-type]


def test_every_phase_but_the_first_can_be_left() -> None:
    for phase in set(HostPhase) - {HostPhase.DISCONNECTED}:
        assert any(source is phase for source, _ in TRANSITIONS)


def test_frames_with_11_bits_are_somebody_elses() -> None:
    bench = Bench().running()
    before = bench.drive.counters["not_for_us"]
    for frame in [*answer(fault=3), Frame(0x339, b"\0\0\0\0"), Frame(57 << 8 | NODE, b"")]:
        bench.hear(frame._replace(is_extended=False))
    assert bench.drive.phase is HostPhase.RUNNING
    assert bench.drive.counters["not_for_us"] == before + 6


FRAMES = st.one_of(
    st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.builds(
        lambda command, node, data: Frame(command << 8 | node, data, is_extended=True),
        st.integers(0, 70),
        st.sampled_from([NODE, HOST, 255, 1]),
        st.binary(max_size=8),
    ),
)


@given(st.lists(st.tuples(FRAMES, st.integers(-5, 20 * MS)), max_size=40))
def test_whatever_comes_nothing_raises_and_nothing_that_moves_is_sent_unasked(frames: list[tuple[Frame, int]]) -> None:
    bench = Bench().ready()
    drive, now_ns = bench.drive, bench.now_ms * MS
    for frame, step_ns in frames:
        now_ns += step_ns
        drive.receive(frame, now_ns)
        assert {command(sent) for sent in drive.poll(now_ns)} <= {REQUEST}
        assert drive.setpoint(0) is None
    stamps = [sample.stamp_ns for sample in drive.take_samples()]
    assert stamps == sorted(set(stamps))


@given(
    st.lists(
        st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 255), st.integers(-10, 370), st.integers(0, 255)),
        max_size=40,
    )
)
def test_whatever_a_running_one_answers_nothing_raises(values: list[tuple[int, int, int, int]]) -> None:
    bench = Bench().running()
    for current, fault, angle, status in values:
        bench.says = lambda found=(angle, current, fault, status): answer(*found)  # type: ignore[misc]
        bench.tick()
    if any(fault for _, fault, angle, _ in values if 0 <= angle <= 360):
        assert bench.drive.phase.name in {"FAULT", "DISCONNECTED", "REFUSED"}
