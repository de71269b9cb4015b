"""Build the site into build/site: `python -m tools.site`. Warnings are errors; the exit code is the generator's."""

import os
import subprocess
import sys

from tools.site.staging import ROOT, stage


def main() -> int:
    """Lay the pages out, and build."""
    stage(ROOT / "build" / "site-pages")
    # Its notice of what follows this generator is answered in docs/decisions/0022-the-documents-as-a-site.md.
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet"]
    code = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    if code == 0:
        print("site: build/site/index.html")
    return code


if __name__ == "__main__":
    sys.exit(main())
