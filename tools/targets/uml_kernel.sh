#!/bin/sh
# A User-Mode Linux kernel with CAN and virtual time (`time-travel`), built from Debian's sources: kernel.sh FOLDER
# leaves FOLDER/linux (6 MB) and can-utils in FOLDER/usr/bin, as a user, nothing installed; 3.5 minutes on two cores.
# Where it stands already, nothing is done. Exit code 3: it can't be had here, with the reason on standard error.
set -eu
folder=$1
source=linux-source-6.1
here=$(cd "$(dirname "$0")" && pwd)
config="$here/uml_kernel.config"
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
exec 9>"$folder/lock"
flock 9 # whoever else wants a kernel waits for this one
[ -x "$folder/linux" ] && cmp -s "$config" "$folder/linux.config" && exit 0

lacking() {
    echo "no kernel for virtual time: $*" >&2
    exit 3
}

fetch() { # fetch PACKAGE...: download and unpack, nothing installed
    for package in "$@"; do
        apt-get -qq download "$package" >/dev/null 2>&1 ||
            { apt-get -qq update && apt-get -qq download "$package"; } >/dev/null 2>&1 || lacking "apt-get can't download $package"
        dpkg -x "$package"_*.deb . && rm "$package"_*.deb
    done
}

for tool in apt-get dpkg flock gcc make xz; do
    command -v "$tool" >/dev/null || lacking "$tool is not installed"
done
work=$(mktemp -d "$folder/build.XXXXXX")
trap 'rm -rf "$work"' EXIT
trap 'exit 143' INT TERM
cd "$work"
fetch "$source" can-utils
command -v bc >/dev/null || fetch bc
command -v flex >/dev/null || fetch flex
command -v bison >/dev/null || fetch bison m4
command -v m4 >/dev/null || fetch m4
export PATH="$work/usr/bin:$PATH" M4="$(command -v m4 || echo "$work/usr/bin/m4")"
[ ! -d usr/share/bison ] || export BISON_PKGDATADIR="$work/usr/share/bison"
tar -xJf "usr/src/$source.tar.xz"
cd "$source"
# The registers of a process are given back to the processor whole or not at all, and those with AMX (Intel, since 2023)
# have 11008 bytes of them. 6.1 keeps 2696, and its first process ends with a panic there; 6.13 asks the processor. A
# kernel stack holds two such sets: hence CONFIG_KERNEL_STACK_ORDER.
offsets=arch/x86/um/user-offsets.c
sed -i 's/DEFINE_LONGS(HOST_FP_SIZE, 2696)/DEFINE_LONGS(HOST_FP_SIZE, 16384)/' "$offsets"
grep -q 'HOST_FP_SIZE, 16384' "$offsets" || lacking "$offsets isn't what it was"
make -s ARCH=um KCONFIG_ALLCONFIG="$config" allnoconfig >/dev/null
grep '^CONFIG_' "$config" | while read -r option; do
    grep -qxF -- "$option" .config || { echo "the kernel's configuration lost $option" >&2; exit 1; }
done
make -s -j"$(nproc)" ARCH=um linux >"$work/make.log" 2>&1 || { tail -20 "$work/make.log" >&2; lacking "it does not compile"; }
mkdir -p "$folder/usr/bin"
cp "$work"/usr/bin/*can* "$folder/usr/bin"
strip -o "$folder/linux.new" linux
cp "$config" "$folder/linux.config"
mv "$folder/linux.new" "$folder/linux"
