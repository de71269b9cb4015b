"""The cache of compiled kernels follows the sources that end up in them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil_forceps.kernels.cache import fingerprint

CALLEE = """
from hil_forceps.kernels.compiler import kernel_compiler
from pathlib import Path
kernel = kernel_compiler(("pack",), Path(__file__).parents[1])

@kernel
def inner(x: float) -> float:
    return x + {constant}
"""
CALLER = """
from pack.inner import inner, kernel

@kernel
def outer(x: float) -> float:
    return inner(x)
"""


def outer_of_zero(root: Path) -> float:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(root / "cache")}
    command = [sys.executable, "-c", "from pack.outer import outer; print(outer(0.0))"]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "__init__.py").touch()
    (tmp_path / "pack" / "inner.py").write_text(CALLEE.format(constant=1.0))
    (tmp_path / "pack" / "outer.py").write_text(CALLER)
    return tmp_path


def test_a_changed_callee_in_another_file_is_not_answered_from_the_cache(package: Path) -> None:
    assert outer_of_zero(package) == 1.0
    (package / "pack" / "inner.py").write_text(CALLEE.format(constant=2.0))
    assert outer_of_zero(package) == 2.0


def test_the_cache_is_used_where_nothing_changed(package: Path) -> None:
    outer_of_zero(package)
    written = {path: path.stat().st_mtime_ns for path in (package / "cache").rglob("*.nb?")}
    assert written
    outer_of_zero(package)
    assert {path: path.stat().st_mtime_ns for path in (package / "cache").rglob("*.nb?")} == written


def test_fingerprint_follows_text_and_name(package: Path) -> None:
    first = fingerprint(("pack",), package)
    assert fingerprint(("pack",), package) == first
    (package / "pack" / "inner.py").rename(package / "pack" / "renamed.py")
    assert fingerprint(("pack",), package) != first


def test_a_source_that_is_not_there_is_an_error(package: Path) -> None:
    with pytest.raises(FileNotFoundError):
        fingerprint(("pack/nowhere.py",), package)
