"""Break the reference firmware in small ways and see whether its tests notice.

python tools/mutation/firmware_mutants.py [--sample N] [--seed S]: prints each mutant that survives, and the share that
does not. A survivor is a missing test or a change without effect; look at each.
"""

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CORE = ROOT / "firmware_protocol" / "c"
TESTS = (
    *(f"tests/unit/firmware/test_{name}.py" for name in ("drive", "node", "codec", "loop")),
    "tests/property/test_firmware_differential.py",
)
SWAPS = (
    (r"(?<![<>=!-])<(?![<=])(?= )", "<="),
    (r"<=", "<"),
    (r"(?<![>-])>(?![>=])(?= )", ">="),
    (r">=", ">"),
    (r"==", "!="),
    (r"!=", "=="),
    (r"&&", "||"),
    (r"\|\|", "&&"),
    (r"(?<= )\+(?= )", "-"),
    (r"(?<= )-(?= )", "+"),
    (r"(?<= )&(?= )", "|"),
    (r"\btrue\b", "false"),
    (r"\bfalse\b", "true"),
    (r"(?<![\w.x])(\d+)(?=[,;}\])u ]|$)", "+1"),
)


def mutants(source: Path) -> Iterator[tuple[int, str]]:
    """Yield (line number, line as it becomes); comments and preprocessor lines stay."""
    for number, line in enumerate(source.read_text().splitlines()):
        code = line.split("/*")[0]
        if not code.strip() or code.lstrip().startswith(("#", "*", "/")):
            continue
        for pattern, replacement in SWAPS:
            for found in re.finditer(pattern, code):
                new = str(int(found.group()) + 1) if replacement == "+1" else replacement
                yield number, code[: found.start()] + new + code[found.end() :]
        if re.fullmatch(r"\s+[^{}]*\);|\s+\S[^{}]* [-+|]?= .*;|\s+\S+(\+\+|--);", code) and "const" not in code:
            yield number, ""


def survives(name: str, number: int, line: str, work: Path) -> bool | None:
    """Build one mutant and test it; None when it does not compile."""
    shutil.copytree(CORE, work / "c", dirs_exist_ok=True)
    lines = (CORE / name).read_text().splitlines()
    lines[number] = line
    (work / "c" / name).write_text("\n".join(lines) + "\n")
    library = work / "libhfp.so"
    sources = [
        *(work / "c").glob("hfp_*.c"),
        work / "c" / "generated" / "motor_driver.c",
        work / "c" / "test" / "sizes.c",
    ]
    build = subprocess.run(
        ["gcc", "-std=c99", "-O1", "-fPIC", "-shared", *map(str, sources), "-lm", "-o", str(library)],
        capture_output=True,
        check=False,
    )
    if build.returncode:
        return None
    environment = {
        **os.environ,
        "HFP_LIBRARY": str(library),
        "HFP_RANDOM_FRAMES": "5000",
        "PYTHONPATH": str(ROOT),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:xdist", *TESTS]
    try:
        result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, check=False, timeout=60)
    except subprocess.TimeoutExpired:
        return False
    return result.returncode == 0


def main() -> int:
    """Try a sample of the mutants; always 0, the judgement is the reader's."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sample", type=int, default=100, help="how many mutants to try; 0: all")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    every = [(path.name, *mutant) for path in sorted(CORE.glob("hfp_*.c")) for mutant in mutants(path)]
    rng = random.Random(arguments.seed)
    chosen = every if arguments.sample == 0 else rng.sample(every, min(arguments.sample, len(every)))
    tried = killed = 0
    with tempfile.TemporaryDirectory(prefix="hfp-mutants-") as directory:
        for name, number, line in chosen:
            outcome = survives(name, number, line, Path(directory))
            if outcome is None:
                continue
            tried += 1
            killed += not outcome
            if outcome:
                print(f"survived: {name}:{number + 1}: {line.strip() or '(line gone)'}", flush=True)
    print(f"{killed} of {tried} killed, of {len(every)} there are")
    return 0


if __name__ == "__main__":
    sys.exit(main())
