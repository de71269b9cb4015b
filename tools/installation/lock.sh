#!/bin/sh
# Writes requirements.lock and requirements-run.lock (what runs, without what develops) anew from pyproject.toml: every
# version pinned, every file by its hash.
# Needs `uv` (pip install uv). Run it when a dependency changes, never by hand.
set -eu
cd "$(dirname "$0")/../.."
compile() {
    uv pip compile pyproject.toml --universal --python-version 3.11 \
        --no-emit-index-url --no-header --no-annotate --generate-hashes --quiet "$@"
}
compile --extra dev --extra site --output-file requirements.lock
compile --extra editable --constraint requirements.lock --output-file requirements-run.lock
