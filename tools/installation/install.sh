#!/bin/sh
# Creates .venv from the lock files. Usage: tools/installation/install.sh [VENV [run]]; PYTHON chooses the interpreter.
# `run`: what the commands need, without what developing does; later the rest is added to it.
set -eu
cd "$(dirname "$0")/../.."
venv=${1:-.venv}
part=${2:-dev}
python=${PYTHON:-python3}

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || {
    echo "install: $python is not Python 3.11 or later; name one with PYTHON=/path/to/python3.11 make install" >&2
    exit 2
}
wanted=$(cat requirements.lock requirements-run.lock pyproject.toml | cksum)
has() { [ -x "$venv/bin/python" ] && [ "$(cat "$venv/.installed-$1" 2>/dev/null)" = "$wanted" ]; }
if has dev || { [ "$part" = run ] && has run; }; then
    exit 0
fi
if ! "$python" -c 'import ensurepip' 2>/dev/null; then
    # Debian and Ubuntu keep ensurepip in a package of its own.
    package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
    echo "install: $python has no ensurepip; installing the Debian package $package" >&2
    if [ "$(id -u)" = 0 ]; then as_root=""; else as_root="sudo -n"; fi
    { $as_root apt-get -qq update && $as_root apt-get -qq install -y "$package"; } >/dev/null || {
        echo "install: could not install it; run: sudo apt-get install $package" >&2
        exit 2
    }
fi
# The lock files are the whole closure. Left to resolve, pip may look at a newer release for an extra (coverage[toml])
# than the one pinned, and ends because that has no hash. What isn't compiled now is compiled when it is first imported.
add() {
    "$venv/bin/python" -m pip install -qq --disable-pip-version-check --no-compile --no-deps --require-hashes -r "$1"
}
if ! has run; then
    echo "install: creating $venv from requirements-run.lock" >&2
    "$python" -m venv --clear "$venv"
    add requirements-run.lock
    "$venv/bin/python" -m pip install -qq --disable-pip-version-check --no-deps --no-build-isolation -e .
    echo "$wanted" >"$venv/.installed-run"
fi
if [ "$part" != run ]; then
    echo "install: adding what developing takes, from requirements.lock" >&2
    add requirements.lock
    "$venv/bin/python" -m pip check --disable-pip-version-check >&2 || {
        echo "install: requirements.lock lacks what pyproject.toml asks for; run: tools/installation/lock.sh" >&2
        exit 2
    }
    echo "$wanted" >"$venv/.installed-dev"
fi
echo "install: done, $("$venv/bin/python" --version) in $venv" >&2
