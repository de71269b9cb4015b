"""`python -m tests.reader_fuzz.campaign N`: N inputs shared among all readers; `--only NAME` for one of them.

The same seed gives the same inputs. An input that takes longer than `HANG_S` of processor time counts as a hang; more
than `MAX_MEMORY_BYTES` of memory fails as well. What is found is shrunk, told and left in `--out` as a file.
"""

import argparse
import resource
import signal
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.reader_fuzz.checks import FoundError
from tests.reader_fuzz.fuzzers import FUZZERS, Fuzzer

BATCH = 1000  # inputs for each seed of hypothesis, which keeps all that it has drawn
HANG_S = 20.0  # a sound input takes milliseconds
MAX_MEMORY_BYTES = 8 << 30  # of addresses: libraries take two


class HangError(BaseException):
    """Not an Exception, for no reader may swallow it."""


def _hang(_: int, __: FrameType | None) -> None:
    raise HangError


def fuzz(name: str, fuzzer: Fuzzer, count: int, number: int, *, shrink: bool = True) -> int:
    """Check so many inputs of one seed; return how many were read. Whatever a check raises goes through."""
    read = 0

    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        report_multiple_bugs=False,
        phases=(Phase.generate, Phase.shrink) if shrink else (Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    @seed(number)
    @given(fuzzer.inputs)
    def run(content: object) -> None:
        nonlocal read
        signal.signal(signal.SIGVTALRM, _hang)
        signal.setitimer(signal.ITIMER_VIRTUAL, HANG_S)
        try:
            read += fuzzer.check(content)
        except HangError:
            raise FoundError(f"{name}: no end within {HANG_S:g} s") from None
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
            latest[name] = content

    run()
    return read


latest: dict[str, object] = {}  # the last input of each fuzzer: after a finding the one that it was shrunk to


def campaign(total: int, first_seed: int, names: Sequence[str], out: Path) -> int:
    """Share `total` inputs among the fuzzers; return how many found something."""
    share = -(-total // len(names))
    bad = 0
    for name in names:
        done = read = 0
        number = first_seed
        try:
            while done < share:
                count = min(BATCH, share - done)
                read += fuzz(name, FUZZERS[name], count, number)
                done, number = done + count, number + 1
        except (Exception, HangError):
            bad += 1
            out.mkdir(parents=True, exist_ok=True)
            content = latest.get(name, b"")
            (out / f"{name}-{number}").write_bytes(content if isinstance(content, bytes) else repr(content).encode())
            sys.stdout.write(
                f"{name}: seed {number}: FOUND, input in {out}/{name}-{number}\n{traceback.format_exc()}\n"
            )
            continue
        sys.stdout.write(f"{name}: {done} inputs, seeds {first_seed} to {number - 1}, {read} of them read\n")
        sys.stdout.flush()
    return bad


def main(arguments: Sequence[str]) -> int:
    """Run the campaign; 1 when anything was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.reader_fuzz.campaign")
    parser.add_argument("inputs", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=sorted(FUZZERS), action="append")
    parser.add_argument("--out", type=Path, default=Path("out/reader-fuzz"))
    chosen = parser.parse_args(arguments)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    return 1 if campaign(chosen.inputs, chosen.seed, chosen.only or sorted(FUZZERS), chosen.out) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
