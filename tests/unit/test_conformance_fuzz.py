"""A megabyte of nonsense; the long campaign is the same with more bytes."""

import pytest

from firmware_protocol import serial_framing
from firmware_protocol.conformance import fuzz
from firmware_protocol.frames import Frame
from firmware_protocol.serial_framing import SerialReader

MEGABYTE = 1_000_000


def test_a_megabyte_of_nonsense_breaks_nothing() -> None:
    outcomes = fuzz.campaign(MEGABYTE)
    assert list(outcomes) == ["fuzz_serial_reader", "fuzz_decoder", "fuzz_drive", "fuzz_host"]
    for outcome in outcomes.values():
        assert outcome.bytes_in >= MEGABYTE // 4
        assert outcome.probes > 40
        assert outcome.frames > 500


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


def test_an_exception_is_no_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def parse(_: bytes) -> Frame | str:
        raise IndexError

    monkeypatch.setattr(serial_framing, "_parse", parse)
    with pytest.raises(IndexError):
        fuzz.fuzz_serial_reader(10_000, 0)


def test_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["20000", "7"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[0].startswith("fuzz_serial_reader: ")
