#!/bin/sh
# Look all locked dependencies up in a database of vulnerabilities, by pip-audit in an environment of its own.
# Usage: tools/release/audit.sh [more for pip-audit, as --vulnerability-service osv]
# Exit code 0: none known; 1: some are, listed; 2: could not be asked (no network, no database). Not part of `make test`.
set -u
cd "$(dirname "$0")/../.."
venv=build/audit
wanted="pip-audit==2.10.0"
answer=build/audit-answer.json
if [ "$(cat "$venv/.installed" 2>/dev/null)" != "$wanted" ]; then
    rm -rf "$venv"
    "${PYTHON:-python3}" -m venv "$venv" && "$venv/bin/python" -m pip install -qq --disable-pip-version-check "$wanted" || {
        echo "audit: could not install $wanted; is there a network?" >&2
        exit 2
    }
    echo "$wanted" >"$venv/.installed"
fi
rm -f "$answer"
# --disable-pip: the lock files are the whole closure, with hashes; nothing is resolved or downloaded.
"$venv/bin/pip-audit" --progress-spinner off --disable-pip --require-hashes \
    -r requirements-run.lock -r requirements.lock --format json --output "$answer" "$@" 2>build/audit-errors.txt
if [ ! -s "$answer" ]; then
    tail -n 1 build/audit-errors.txt >&2
    echo "audit: could not be asked; the database of vulnerabilities can't be reached, or its answer isn't one" >&2
    exit 2
fi
"$venv/bin/python" tools/release/audit_answer.py "$answer"
