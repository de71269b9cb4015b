"""An FMU out of a unit: C text, compiled for the platforms that a compiler is there for, in an archive."""

import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, NamedTuple

from hil_forceps.fmu.model_description import build_description, model_description
from hil_forceps.fmu.source import sources
from hil_forceps.fmu.unit import Unit
from hil_forceps.rig.errors import UserError

_INSTALL = "pip install 'hil-forceps[fmu]'"
# The same archive for the same rig: no clock in it.
_GENERATED = "2000-01-01T00:00:00Z"
_STAMP = (2000, 1, 1, 0, 0, 0)


PlatformName = Literal["x86_64-linux", "x86_64-windows", "x86_64-darwin", "aarch64-darwin", "aarch64-linux"]


class Platform(NamedTuple):
    """A kind of machine, by the names that the standard and the compiler have for it."""

    name: PlatformName  # FMI 3.0's
    fmi2: str  # FMI 2.0's, which has none for ARM
    target: str  # of zig
    ending: str


PLATFORMS = (
    Platform("x86_64-linux", "linux64", "x86_64-linux-gnu.2.17", ".so"),
    Platform("x86_64-windows", "win64", "x86_64-windows-gnu", ".dll"),
    Platform("x86_64-darwin", "darwin64", "x86_64-macos", ".dylib"),
    Platform("aarch64-darwin", "", "aarch64-macos", ".dylib"),
    Platform("aarch64-linux", "", "aarch64-linux-gnu.2.17", ".so"),
)
_HERE = PLATFORMS[0]

# No contraction of a*b+c: the same bits on every machine that has the same functions of libm.
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC", "-shared", "-s")


def write_fmu(
    unit: Unit,
    fmi: Literal[2, 3],
    out: Path,
    platforms: Sequence[PlatformName] = ("x86_64-linux",),
    *,
    zig: bool = True,
) -> None:
    """Write an FMU for a version of the standard, with a library for each platform and the sources for all others.

    `zig=False`: by this machine's own compiler, for this machine. UserError where no compiler is there for a platform,
    FMI 2.0 has no name for it, or the standard's headers are missing.
    """
    files, token = sources(unit, fmi)
    headers = _headers(fmi)
    main = next(iter(files))
    content: dict[str, bytes] = {"modelDescription.xml": model_description(unit, fmi, token, [main], _GENERATED)}
    content |= {f"sources/{name}": text.encode() for name, text in {**files, **headers}.items()}
    if fmi == 3:
        content["sources/buildDescription.xml"] = build_description(unit, [main])
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, text in {**files, **headers}.items():
            (folder / name).write_text(text, encoding="utf-8")
        for platform in (each for each in PLATFORMS if each.name in platforms):
            where = platform.fmi2 if fmi == 2 else platform.name
            if not where:
                raise UserError(f"--platform {platform.name}: not defined in FMI 2.0; use --fmi 3")
            library = folder / f"{unit.name}{platform.ending}"
            _compile(_compiler(platform, zig=zig), folder / main, library)
            content[f"binaries/{where}/{library.name}"] = library.read_bytes()
    _pack(out, content)


def _headers(fmi: int) -> dict[str, str]:
    """Return the standard's own headers, which fmpy has with it."""
    found = find_spec("fmpy")
    if found is None or found.origin is None:
        raise UserError(f"fmpy is missing, which contains the headers of the FMI standard; {_INSTALL}")
    folder = Path(found.origin).parent / "c-code"
    platform = "fmi2TypesPlatform.h" if fmi == 2 else "fmi3PlatformTypes.h"
    names = (f"fmi{fmi}Functions.h", f"fmi{fmi}FunctionTypes.h", platform)
    return {name: (folder / name).read_text(encoding="utf-8", errors="replace") for name in names}


def _compiler(platform: Platform, *, zig: bool) -> list[str]:
    """Return the command that compiles for a platform; UserError where none is there."""
    if zig and find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", platform.target]
    own = shutil.which("cc")
    if platform == _HERE and own is not None:
        return [own]
    raise UserError(f"no C compiler for {platform.name} was found; {_INSTALL}, which includes one for all platforms")


def _compile(compiler: list[str], source: Path, library: Path) -> None:
    """Compile one file to a shared library; RuntimeError with what the compiler said where it can't."""
    libraries = [] if library.suffix == ".dll" else ["-lm"]
    command = [*compiler, *_FLAGS, source.name, "-o", library.name, *libraries]
    ran = subprocess.run(command, cwd=source.parent, capture_output=True, text=True, check=False)  # noqa: S603 - above
    if ran.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {ran.stderr.strip()}")


def _pack(out: Path, content: dict[str, bytes]) -> None:
    """Write an archive; the same content gives the same bytes."""
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(content):
            archive.writestr(zipfile.ZipInfo(name, _STAMP), content[name], zipfile.ZIP_DEFLATED)
