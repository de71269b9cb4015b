"""Where compiled kernels are kept: a folder named after the text of all that ends up in them.

A kernel holds the code of the kernels it calls and the values of the constants it names, from other files than its own.
A cache by the text of one file would go on answering with the old code when another changes.
"""

import hashlib
import os
import stat
from collections.abc import Sequence
from pathlib import Path

from hil_forceps.rig.errors import UserError

_HERE = Path(__file__).parent


def cache_folder(sources: Sequence[str], root: Path) -> Path:
    """Return the folder for kernels built from `sources`, files and folders relative to `root`."""
    return _cache_base(root) / f"kernels-{fingerprint(sources, root)}"


def fingerprint(sources: Sequence[str], root: Path) -> str:
    """Return a short name for the text of `sources` and of this package, which says how they are compiled.

    FileNotFoundError when one is not there.
    """
    digest = hashlib.blake2b(digest_size=8)
    for file in sorted(path for path in _HERE.rglob("*") if path.suffix in {".py", ".h"}):
        digest.update(file.read_bytes())
    for source in sources:
        path = root / source
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(f"{file.relative_to(root)}\0".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _cache_base(root: Path) -> Path:
    """Return NUMBA_CACHE_DIR where it is set, else beside the sources where that can be written, else the user's."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return _private(Path(chosen))
    beside = root / "hil_forceps" / "__pycache__"
    if os.access(beside if beside.is_dir() else beside.parent, os.W_OK):
        return beside
    return _private(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hil-forceps")


def _private(folder: Path) -> Path:
    """Return a folder for compiled code, which is loaded and run; UserError where others may put theirs into it.

    One beside the sources is as safe as these are.
    """
    try:
        found = folder.stat()
    except OSError:
        return folder  # it will be made, for this user alone to write to
    if found.st_mode & stat.S_IWOTH or found.st_uid not in {0, os.getuid()}:
        raise UserError(
            f"{folder}: compiled kernels are kept here, and other users may write to it; set NUMBA_CACHE_DIR to a "
            "folder of your own (`chmod go-w`)"
        )
    return folder
