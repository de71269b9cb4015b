"""Lines for people out of pip-audit's JSON: what is known of which package, and the version that mends it.

Usage: python tools/release/audit_answer.py FILE. Exit code 0: none known; 1: some are; 2: the file is no such answer,
or doesn't tell of every package.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

EXIT_FOUND, EXIT_NO_ANSWER = 1, 2


def main(path: str) -> int:
    """Print what the file says."""
    try:
        packages = json.loads(Path(path).read_text(encoding="utf-8"))["dependencies"]
        known = list(_known(packages))
        skipped = {str(each["name"]): str(each["skip_reason"]) for each in packages if "skip_reason" in each}
    except (OSError, ValueError, KeyError, TypeError) as error:
        print(f"audit: {path} is no answer of pip-audit: {error}", file=sys.stderr)
        return EXIT_NO_ANSWER
    for line in known:
        print(line)
    print(f"audit: {len(packages) - len(skipped)} packages looked up, {len(known)} known vulnerabilities")
    if skipped or not packages:
        first = next(iter(skipped.values()), "there is none in it")
        print(f"audit: {len(skipped)} packages could not be looked up: {first}", file=sys.stderr)
        return EXIT_FOUND if known else EXIT_NO_ANSWER
    return EXIT_FOUND if known else 0


def _known(packages: list[dict[str, Any]]) -> Iterator[str]:
    for package in packages:
        for each in package.get("vulns", ()):
            mended = ", ".join(each["fix_versions"]) or "no version yet"
            aliases = ", ".join(each.get("aliases", ()))
            yield f"{package['name']} {package['version']}: {each['id']} ({aliases}); mended in {mended}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
