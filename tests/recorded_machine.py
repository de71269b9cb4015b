"""A machine of recorded texts in place of this one: a tree of files, and what commands say."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NoReturn

from hil_forceps.bridge.doctor.reads import ClockStatus, Space, System


def refused(number: int, words: str) -> NoReturn:
    raise OSError(number, words)


class Recorded(System):
    """Files below a folder; the rest as attributes, None where the machine doesn't tell."""

    def __init__(self, root: Path, files: Mapping[str, str] | None = None) -> None:
        super().__init__(root)
        self.root = root
        self.said: str | None = None  # by `ip`
        self.policy: tuple[int, int] | None = (0, 0)
        self.allowed: frozenset[int] | None = frozenset({0, 1})
        self.clock: ClockStatus | None = ClockStatus(True, 0.002)
        self.left: Space | None = Space(10**12, True)
        self.opens: bool | None = True
        self.asked: list[Sequence[str]] = []
        self.put(files or {})

    def put(self, files: Mapping[str, str]) -> "Recorded":
        for name, text in files.items():
            path = self.root / name.lstrip("/")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        return self

    def run(self, command: Sequence[str]) -> str:
        self.asked.append(command)
        return refused(2, "No such file or directory") if self.said is None else self.said

    def scheduling(self) -> tuple[int, int]:
        return refused(1, "Operation not permitted") if self.policy is None else self.policy

    def cores(self) -> frozenset[int]:
        return refused(1, "Operation not permitted") if self.allowed is None else self.allowed

    def clock_status(self) -> ClockStatus:
        return refused(1, "Operation not permitted") if self.clock is None else self.clock

    def space(self, folder: str) -> Space:
        del folder
        return refused(2, "No such file or directory") if self.left is None else self.left

    def may_open(self, path: str) -> bool:
        del path
        return refused(2, "No such file or directory") if self.opens is None else self.opens
