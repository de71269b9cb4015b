"""Kernels for whole runs: the C compiler's and numba's give the same bits, and what can't be is told."""

import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba.core import event
from numpy.typing import NDArray

from hil_forceps.kernels.library import COMPILING
from hil_forceps.kernels.run_kernel import RunKernel

Vector = NDArray[np.float64]


class Mixed(NamedTuple):
    """Fields of all kinds, out of line in memory."""

    flag: bool
    single: NDArray[np.float32]
    whole: int
    inner: tuple[bool, float]
    marks: NDArray[np.bool_]
    cube: NDArray[np.float64]
    empty: NDArray[np.int64]


def sums(m: Mixed, factor: float, out: Vector) -> float:
    total = 0.0
    for i in range(m.cube.shape[0]):
        for j in range(m.cube.shape[1]):
            for k in range(m.cube.shape[2]):
                total += m.cube[i, j, k] / (1.0 + k)
        out[i] = total * factor + (1.0 if m.marks[i] else 0.0) + m.single[i]
    return total + m.whole + (m.inner[1] if m.inner[0] else 0.0) + (1000.0 if m.flag else 0.0) + m.empty.size


def fill(out: Vector) -> None:
    work = np.zeros(100)
    for i in range(out.size):
        work[i % 100] += 0.1 * i
        out[i] = work[i % 100]


def again_and_again(x: Vector, out: Vector) -> None:
    for i in range(out.size):
        out[i] = (x * 2.0).sum() + i


def squander(size: int) -> None:
    work = np.empty(size)
    for i in range(size):
        work[i] = 1.0


def mixed(rows: int) -> Mixed:
    rng = np.random.default_rng(rows)
    return Mixed(
        True,
        rng.standard_normal(rows).astype(np.float32),
        7,
        (True, 0.25),
        rng.standard_normal(rows) > 0.0,
        rng.standard_normal((rows, 2, 3)),
        np.zeros(0, dtype=np.int64),
    )


def kernel_of(function: Callable[..., Any], folder: Path) -> RunKernel:
    return RunKernel(function, numba.njit(error_model="numpy")(function), folder)


class Counting(event.Listener):
    """Counts what is compiled by the C compiler."""

    def __init__(self) -> None:
        self.times = 0

    def on_start(self, event: event.Event) -> None:  # noqa: ARG002
        self.times += 1

    def on_end(self, event: event.Event) -> None:
        pass


@pytest.fixture
def compiled() -> Any:
    counting = Counting()
    with event.install_listener(COMPILING, counting):
        yield counting


def test_both_compilers_and_python_give_the_same(tmp_path: Path, compiled: Counting) -> None:
    kernel, given = kernel_of(sums, tmp_path), mixed(5)
    by_c, by_numba, by_python = np.zeros(5), np.zeros(5), np.zeros(5)
    returned = kernel(given, 1.5, by_c)
    assert compiled.times == 1
    assert returned == kernel.by_numba(given, 1.5, by_numba) == sums(given, 1.5, by_python)
    assert by_c.tobytes() == by_numba.tobytes() == by_python.tobytes()


def test_a_kernel_is_compiled_once_for_each_choice_of_types(tmp_path: Path, compiled: Counting) -> None:
    kernel = kernel_of(sums, tmp_path)
    for rows in (2, 3):
        kernel(mixed(rows), 1, np.zeros(rows))  # an integer for a float is the same
    assert compiled.times == 1
    for _ in range(2):
        kernel(mixed(2)._replace(empty=np.zeros(0)), 1.0, np.zeros(2))  # type: ignore[arg-type]
        assert compiled.times == 2
    kernel_of(sums, tmp_path)(mixed(2), 1.0, np.zeros(2))  # as another process would
    assert compiled.times == 2


def test_arrays_may_be_read_only_or_empty(tmp_path: Path) -> None:
    kernel, out = kernel_of(fill, tmp_path), np.zeros(250)
    kernel(out)
    by_python = np.zeros(250)
    fill(by_python)
    assert out.tobytes() == by_python.tobytes()
    kernel(np.zeros(0))
    given = mixed(3)
    given.cube.flags.writeable = False
    assert kernel_of(sums, tmp_path)(given, 1.0, np.zeros(3)) == sums(given, 1.0, np.zeros(3))


def test_what_no_kernel_takes_is_an_error(tmp_path: Path) -> None:
    kernel = kernel_of(fill, tmp_path)
    with pytest.raises(TypeError, match="side by side"):
        kernel(np.zeros((10, 2))[:, 0])
    with pytest.raises(TypeError, match="no str"):
        kernel("out")
    with pytest.raises(TypeError, match=r"2\.5 where int64_t"):
        kernel_of(squander, tmp_path)(2.5)
    with pytest.raises(NotImplementedError, match="int16"):
        kernel(np.zeros(3, dtype=np.int16))


def test_what_a_loop_makes_each_time_takes_no_more_room(tmp_path: Path) -> None:
    out = np.zeros(10_000)
    kernel_of(again_and_again, tmp_path)(np.ones(100), out)
    assert out[-1] == 200.0 + 9999.0


def apart(x: Vector, y: Vector, out: Vector) -> None:
    out[:] = x - y


def test_sizes_that_do_not_go_together_are_an_error(tmp_path: Path) -> None:
    kernel = kernel_of(apart, tmp_path)
    kernel(np.ones(3), np.ones(3), np.zeros(3))
    with pytest.raises(ValueError, match="don't go together"):
        kernel(np.ones(3), np.ones(2), np.zeros(3))
    with pytest.raises(ValueError, match="don't go together"):
        kernel(np.ones(3), np.ones(3), np.zeros(4))


def counter(x: Vector) -> float:
    found = 0
    for i in range(x.size):
        found += 1 if x[i] > 0.0 else 0
    return found


def test_what_is_returned_is_of_the_type_that_it_says(tmp_path: Path) -> None:
    assert kernel_of(counter, tmp_path)(np.array([1.0, -1.0, 2.0, 0.5])) == 3.0


def scaled_by(factor: float) -> Callable[[float], float]:
    def scaled(x: float) -> float:
        return factor * x

    return scaled


def test_functions_of_one_name_are_told_apart(tmp_path: Path) -> None:
    assert [kernel_of(scaled_by(factor), tmp_path)(1.5) for factor in (2.0, 3.0)] == [3.0, 4.5]


class First(NamedTuple):
    a: float
    b: float


class Second(NamedTuple):
    b: float
    a: float


def first(pair: First) -> float:
    return pair.a


def test_another_tuple_or_array_is_another_type(tmp_path: Path) -> None:
    kernel = kernel_of(first, tmp_path)
    assert kernel(First(1.0, 2.0)) == 1.0
    assert kernel(Second(1.0, 2.0)) == 2.0
    with pytest.raises(NotImplementedError):
        kernel(np.array([3.0, 4.0]))


def test_arrays_of_another_process_are_taken(tmp_path: Path) -> None:
    sent = pickle.loads(pickle.dumps(np.zeros(4)))
    kernel_of(fill, tmp_path)(sent)
    assert sent[3] == pytest.approx(0.3)


def test_arrays_as_long_as_a_run_are_not_made_by_a_kernel(tmp_path: Path) -> None:
    kernel = kernel_of(squander, tmp_path)
    kernel(1000)
    with pytest.raises(RuntimeError, match="are to be given"):
        kernel(10_000_000)
    kernel(1000)


@pytest.mark.parametrize("command", ["", "no-such-compiler"])
def test_without_a_compiler_numba_does_it(
    command: str, tmp_path: Path, compiled: Counting, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", command)
    out, by_python = np.zeros(5), np.zeros(5)
    kernel_of(sums, tmp_path)(mixed(5), 1.5, out)
    sums(mixed(5), 1.5, by_python)
    assert out.tobytes() == by_python.tobytes()
    assert compiled.times == 0


def test_a_compiler_that_fails_is_told_and_numba_does_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\necho 'no headers here' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    kernel, out = kernel_of(fill, tmp_path / "cache"), np.zeros(5)
    with pytest.warns(UserWarning, match="no headers here"):
        kernel(out)
    kernel(out)  # once is enough
    assert out[4] == 0.4


def test_a_changed_callee_in_another_file_is_not_answered_from_the_cache(tmp_path: Path) -> None:
    assert shutil.which("cc")
    pack = tmp_path / "pack"
    pack.mkdir()
    (pack / "__init__.py").touch()
    (pack / "outer.py").write_text(
        "from pathlib import Path\nfrom hil_forceps.kernels.compiler import run_kernel_compiler\n"
        "from pack.inner import inner\n"
        "@run_kernel_compiler(('pack',), Path(__file__).parents[1])\n"
        "def outer(x: float) -> float:\n    return inner(x)\n"
    )
    for constant in (1.0, 2.0):
        (pack / "inner.py").write_text(
            "from hil_forceps.kernels.compiler import subroutine\n"
            f"@subroutine\ndef inner(x: float) -> float:\n    return x + {constant}\n"
        )
        command = [sys.executable, "-c", "from pack.outer import outer; print(outer(0.0))"]
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env={"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PATH": "/usr/bin:/bin", "PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        assert float(done.stdout) == constant
    assert len(list((tmp_path / "cache").rglob("*.so"))) == 2
