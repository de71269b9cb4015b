"""Compiled kernels are loaded from folders into which nobody else writes."""

import os
from pathlib import Path

import pytest

from hil_forceps.kernels import cache as kernel_cache
from hil_forceps.rig.errors import UserError


def test_a_cache_that_others_may_write_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tmp_path / "cache"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    assert kernel_cache._cache_base(tmp_path) == cache  # it will be made
    cache.mkdir(mode=0o755)
    assert kernel_cache._cache_base(tmp_path) == cache
    cache.chmod(0o777)
    with pytest.raises(UserError, match="other users may write to it; set NUMBA_CACHE_DIR"):
        kernel_cache._cache_base(tmp_path)


def test_a_cache_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    if tmp_path.stat().st_uid == 0:  # root's are trusted
        assert kernel_cache._cache_base(tmp_path) == tmp_path
    else:
        with pytest.raises(UserError):
            kernel_cache._cache_base(tmp_path)


def test_the_users_own_cache_is_looked_at_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda *_: False)  # sources that can't be written to
    cache = tmp_path / "hil-forceps"
    cache.mkdir(mode=0o700)
    assert kernel_cache._cache_base(tmp_path) == cache
    cache.chmod(0o707)
    with pytest.raises(UserError):
        kernel_cache._cache_base(tmp_path)
