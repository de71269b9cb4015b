#!/bin/sh
# Install the browser that the tests of the live page want: Debian's chromium. Fast where it is there.
# Needs root, or sudo without a password. Exit code 1 when there is none at the end. Debian and Ubuntu.
set -u
there() { command -v chromium >/dev/null 2>&1 || command -v chromium-browser >/dev/null 2>&1 || command -v google-chrome >/dev/null 2>&1; }
if there; then
    exit 0
fi
as_root=
if [ "$(id -u)" -ne 0 ]; then
    if ! sudo -n true 2>/dev/null; then
        echo "install as root: apt-get install chromium" >&2
        exit 1
    fi
    as_root='sudo -n'
fi
if ! command -v apt-get >/dev/null 2>&1; then
    echo "no apt-get here; install by hand: chromium" >&2
    exit 1
fi
export DEBIAN_FRONTEND=noninteractive
$as_root apt-get update -qq && $as_root apt-get install -y -qq --no-install-recommends chromium fonts-dejavu-core >/dev/null
there || {
    echo "still missing: chromium" >&2
    exit 1
}
