#!/bin/sh
# Install what the emulated targets need: cross-compiler, QEMU, clang. Fast when all is there, and safe to run again.
#   tools/installation/install_targets.sh           install what is missing; needs root, or sudo without a password
#   tools/installation/install_targets.sh --check   only say what is missing
# Exit code 1 when something is missing at the end. Debian and Ubuntu.
set -u

# command:package
WANTED='gcc:gcc make:make arm-none-eabi-gcc:gcc-arm-none-eabi qemu-system-arm:qemu-system-arm clang:clang'
NEWLIB=libnewlib-arm-none-eabi

missing() {
    for pair in $WANTED; do
        command -v "${pair%%:*}" >/dev/null 2>&1 || printf '%s ' "${pair#*:}"
    done
    # The compiler without its C library links nothing.
    if ! command -v arm-none-eabi-gcc >/dev/null 2>&1 ||
        [ "$(arm-none-eabi-gcc -print-file-name=nano.specs)" = nano.specs ]; then
        printf '%s ' "$NEWLIB"
    fi
    # Nor does clang without its sanitizers, whose package is called after its version.
    if command -v clang >/dev/null 2>&1 &&
        ! ls "$(clang -print-resource-dir)"/lib/*/libclang_rt.fuzzer* >/dev/null 2>&1; then
        version=$(clang -dumpversion)
        printf '%s ' "libclang-rt-${version%%.*}-dev"
    fi
}

packages=$(missing)
if [ -z "$packages" ]; then
    exit 0
fi
if [ "${1:-}" = --check ]; then
    echo "missing: $packages"
    exit 1
fi

as_root=
if [ "$(id -u)" -ne 0 ]; then
    if ! sudo -n true 2>/dev/null; then
        echo "install as root: apt-get install $packages" >&2
        exit 1
    fi
    as_root='sudo -n'
fi
if ! command -v apt-get >/dev/null 2>&1; then
    echo "no apt-get here; install by hand: $packages" >&2
    exit 1
fi
export DEBIAN_FRONTEND=noninteractive
# shellcheck disable=SC2086 # words, on purpose
$as_root apt-get update -qq && $as_root apt-get install -y -qq --no-install-recommends $packages >/dev/null
packages=$(missing) # what a compiler wants shows when it is there
# shellcheck disable=SC2086
[ -z "$packages" ] || $as_root apt-get install -y -qq --no-install-recommends $packages >/dev/null

packages=$(missing)
if [ -n "$packages" ]; then
    echo "still missing: $packages" >&2
    exit 1
fi
