#!/bin/sh
# Writes requirements.lock anew from pyproject.toml: every version pinned, every file by its hash.
# Needs `uv` (pip install uv). Run it when a dependency changes, never by hand.
set -eu
cd "$(dirname "$0")/.."
uv pip compile pyproject.toml --extra dev --universal --python-version 3.11 \
    --no-emit-index-url --no-header --no-annotate --generate-hashes --quiet --output-file requirements.lock
