"""A megabyte of nonsense; the long campaign is the same with more bytes."""

from collections.abc import Callable
from types import ModuleType

import pytest

from firmware_protocol import codec, serial_framing
from firmware_protocol.conformance import fuzz, fuzz_links
from firmware_protocol.drive.machine import DriveMachine
from firmware_protocol.drive.parameter_values import ParameterStore
from firmware_protocol.frames import Frame
from firmware_protocol.host.machine import HostMachine
from firmware_protocol.messages import Message, ParamOp
from firmware_protocol.serial_framing import SerialReader

MEGABYTE = 1_000_000


def test_a_megabyte_of_nonsense_breaks_nothing() -> None:
    outcomes = fuzz.campaign(MEGABYTE)
    assert list(outcomes) == [fuzzer.__name__ for fuzzer in fuzz.FUZZERS]
    for outcome in outcomes.values():
        assert outcome.bytes_in >= MEGABYTE // len(fuzz.FUZZERS)
        assert outcome.probes > 30
        assert outcome.frames > 300


def test_the_same_seed_gives_the_same_campaign() -> None:
    assert fuzz.campaign(20_000, 3) == fuzz.campaign(20_000, 3)
    assert fuzz.campaign(20_000, 3) != fuzz.campaign(20_000, 4)


class Hoarder(SerialReader):
    """Keeps what it should skip."""

    def feed(self, data: bytes) -> list[Frame]:
        frames = super().feed(data)
        if self._skipping:
            self._partial += data
        return frames


class Sulker(SerialReader):
    """Never recovers from a long packet."""

    def feed(self, data: bytes) -> list[Frame]:
        return [] if self.counters["too_long"] else super().feed(data)


@pytest.mark.parametrize(("reader", "words"), [(Hoarder, "bytes kept"), (Sulker, "was not found")])
def test_what_is_broken_is_found(reader: type[SerialReader], words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "SerialReader", reader)
    with pytest.raises(fuzz.Finding, match=words):
        fuzz.fuzz_serial_reader(50_000, 0)


class Hoarding(HostMachine):
    """Keeps every measurement until somebody takes it."""

    def receive(self, frame: Frame, received_ns: int) -> None:
        super().receive(frame, received_ns)
        self._samples._queue.extend(self._samples._queue.copy())


class Sulking(HostMachine):
    """Takes nothing more after the first frame that is damaged."""

    def receive(self, frame: Frame, received_ns: int) -> None:
        if not self.counters["bad_crc"]:
            super().receive(frame, received_ns)


class Lenient(ParameterStore):
    """Takes any value for a parameter that may be written."""

    def execute(self, op: int, number: int, value: int, disabled: bool) -> tuple[ParamOp, int]:
        result, held = super().execute(op, number, value, disabled)
        if result is ParamOp.OUT_OF_RANGE:
            self._values[number] = value
            return ParamOp.OK, value
        return result, held


class Deaf(DriveMachine):
    """Answers no request after the first frame of a wrong length."""

    def receive(self, frame: Frame, now_us: int, theta_m_raw: int) -> list[Frame]:
        answers = super().receive(frame, now_us, theta_m_raw)
        return [] if self.counters["bad_length"] else answers


class Raising(codec.Decoder):
    """Looks at the first byte before it looks at the length."""

    def decode(self, frame: Frame) -> Message | None:
        return super().decode(frame) if frame.data[0] >= 0 else None


@pytest.mark.parametrize(
    ("fuzzer", "where", "name", "broken", "words"),
    [
        (fuzz.fuzz_parameters, fuzz, "ParameterStore", Lenient, "gave OK and"),
        (fuzz.fuzz_drive, fuzz, "DriveMachine", Deaf, "no answer to a good request"),
        (fuzz.fuzz_host, fuzz_links, "HostMachine", Hoarding, "queues grow"),
        (fuzz.fuzz_host, fuzz_links, "HostMachine", Sulking, "no connection"),
        (fuzz.fuzz_line, fuzz_links, "SerialReader", Hoarder, "bytes kept"),
        (fuzz.fuzz_line, fuzz_links, "SerialReader", Sulker, "no connection"),
    ],
)
def test_each_fuzzer_finds_what_is_broken(
    fuzzer: Callable[[int, int], fuzz.Outcome],
    where: ModuleType,
    name: str,
    broken: type,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(where, name, broken)
    with pytest.raises(fuzz.Finding, match=words):
        fuzzer(400_000, 0)


def test_an_exception_on_an_empty_payload_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(codec, "Decoder", Raising)
    with pytest.raises(IndexError):
        fuzz.fuzz_decoder(100_000, 0)


def test_an_exception_is_no_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def parse(_: bytes) -> Frame | str:
        raise IndexError

    monkeypatch.setattr(serial_framing, "_parse", parse)
    with pytest.raises(IndexError):
        fuzz.fuzz_serial_reader(10_000, 0)


def test_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["20000", "7"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 6
    assert lines[0].startswith("fuzz_serial_reader: ")
