"""A short fuzz of every reader; `make fuzz-readers` has more inputs. And what it finds when a reader is broken."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import strategies as st

from firmware_protocol.frames import Frame
from hil_forceps.data.readers.bus_logs.account import Account, LoggedFrame
from hil_forceps.data.readers.tables import text_table
from hil_forceps.data.readers.tables.blocks import Block
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import campaign, logs, sound_files
from tests.reader_fuzz.checks import FoundError
from tests.reader_fuzz.fuzzers import FUZZERS

INPUTS = 150
FEW_INPUTS = 6  # of containers: each is read by a process of its own
CONTAINERS = ("excel", "hdf5", "mf4")


@pytest.mark.parametrize("name", FUZZERS)
def test_no_input_hangs_crashes_or_lies(name: str) -> None:
    campaign.fuzz(name, FUZZERS[name], FEW_INPUTS if name in CONTAINERS else INPUTS, 7)


# What was found, or might be, where a pattern goes back and forth in one long line.
LONG_LINES = {
    "digits": b"9" * 60_000 + b"x\n",
    "blanks": b"a" + b" " * 60_000 + b"x\n",
    "brackets": b"a" + b"_" * 30_000 + b"[" * 30_000 + b"\n",
    "slashes": b"a / " * 15_000 + b"\n",
    "names": b"theta_m [deg]," * 4_000 + b"\n",
    "quotes": b'"' * 60_000 + b"\n",
}


@pytest.mark.parametrize("name", LONG_LINES)
def test_one_long_line_takes_time_with_its_length(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "HANG_S", 5.0)
    fuzzer = FUZZERS["layouts"]._replace(inputs=st.just(LONG_LINES[name] + b"0,1,2\n" * 5))
    assert campaign.fuzz("layouts", fuzzer, 1, 0, shrink=False) == 0


def test_inputs_are_read_as_often_as_they_are_refused() -> None:
    """What is damaged too much is refused at its head, and fuzzes nothing behind it."""
    read = {name: campaign.fuzz(name, FUZZERS[name], INPUTS, 8) for name in ("log", "asc", "trc", "mcap", "cut_log")}
    assert all(INPUTS // 5 < count < INPUTS for count in read.values()), read


def test_files_that_are_damaged_do_not_hold_the_time_they_were_written_at(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for now_s in (1.6e9, 1.7e9):
        monkeypatch.setattr(time, "time", lambda now_s=now_s: now_s)
        monkeypatch.setattr(time, "localtime", lambda _=None, now_s=now_s: time.gmtime(now_s))
        monkeypatch.setattr(time, "asctime", lambda now_s=now_s: str(now_s))
        sound_files.container.cache_clear()
        packed = {name: sound_files.container(name) for name in ("a.xlsx", "a.h5")}
        texts = {"gz": sound_files.packed_text(b"time_s", "gz"), "mat": sound_files.mat()}
        found.append(sound_files.tables() | packed | texts | {"structure": sound_files.mat_structure()})
    assert {name for name, data in found[0].items() if data != found[1][name]} == set()


def test_the_same_seed_gives_the_same_inputs() -> None:
    seen: list[list[object]] = [[], []]
    for inputs in seen:

        def keep(content: object, inputs: list[object] = inputs) -> bool:
            inputs.append(content)
            return True

        campaign.fuzz("log", FUZZERS["log"]._replace(check=keep), 50, 3)
    assert seen[0] == seen[1]
    assert len(seen[0]) == 50


def of_python_can(path: Path, account: Account) -> Iterator[LoggedFrame]:
    """Read a log as it was read before: by python-can alone."""
    del account
    try:
        with can.LogReader(path) as log:
            for message in log:
                yield LoggedFrame(None, "", Frame(message.arbitration_id & 0x7FF, bytes(message.data), message.is_fd))
    except Exception as error:  # whatever its parsers raise
        raise UserError(f"{path}: {type(error).__name__}") from error


def endless(path: Path, account: Account) -> Iterator[LoggedFrame]:
    """Come to no end, and yield nothing."""
    while path.name:
        account.others.clear()
    yield LoggedFrame(None, "", Frame(0, b""))


def uncounted(path: Path, account: Account) -> Iterator[LoggedFrame]:
    """Raise what Python raises."""
    raise ValueError(f"{path}: not enough values to unpack {account}")


# python-can leaves a file open when its reader is stopped.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("name", "broken", "told"),
    [
        ("blf", of_python_can, "more than .* frames out of|no end within"),
        ("log", endless, "no end within"),
        ("trc", uncounted, "not enough values"),
        ("cut_log", of_python_can, "other frames|not a word|too few|refused"),
    ],
)
def test_a_broken_log_reader_is_found(
    name: str, broken: Callable[..., Any], told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logs, "read_frames", broken)
    monkeypatch.setattr(campaign, "HANG_S", 0.5)
    with pytest.raises((FoundError, ValueError), match=told):
        campaign.fuzz(name, FUZZERS[name], 2000, 0, shrink=False)


def test_a_csv_reader_that_believes_its_last_line_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def believing(path: Path, pieces: Iterator[bytes], notes: list[str]) -> Iterator[Block]:
        del path, notes
        yield Block(b"".join(pieces), 0, is_last=True)

    monkeypatch.setattr(text_table, "whole_blocks", believing)
    with pytest.raises(FoundError):
        campaign.fuzz("cut_csv", FUZZERS["cut_csv"], 300, 0, shrink=False)
