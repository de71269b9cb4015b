#!/usr/bin/env bash
# Makes a release: version, changelog, wheel, a try of the wheel in an empty environment, commit and tag. Pushes nothing.
#
# usage: tools/release/release.sh VERSION
set -euo pipefail
cd "$(dirname "$0")/../.."
version=${1:-}
[[ $version =~ ^[0-9]+\.[0-9]+\.[0-9]+$ ]] || { echo "release: usage: tools/release/release.sh MAJOR.MINOR.PATCH" >&2; exit 2; }
[ -z "$(git status --porcelain)" ] || { echo "release: the working tree has changes; commit or stash them" >&2; exit 2; }
if git rev-parse --quiet --verify "refs/tags/v$version" >/dev/null; then
    echo "release: the tag v$version is there already" >&2
    exit 2
fi
grep -q '^## \[Unreleased\]' CHANGELOG.md || { echo "release: CHANGELOG.md has no section [Unreleased]" >&2; exit 2; }

make test

today=$(date +%F)
sed -i "s/^__version__ = .*/__version__ = \"$version\"/" hil_forceps/__init__.py
sed -i "s/^## \[Unreleased\]/## [Unreleased]\n\n## [$version] - $today/" CHANGELOG.md
sed -i "s/^version: .*/version: $version/; s/^date-released: .*/date-released: \"$today\"/" CITATION.cff

rm -rf dist
make wheel
trial=$(mktemp -d)
trap 'rm -rf "$trial"' EXIT
python3 -m venv "$trial"
"$trial/bin/python" -m pip install -qq --disable-pip-version-check dist/*.whl
"$trial/bin/hil-forceps" --version | grep -qx "$version"

git commit -qam "Release $version"
git tag -a "v$version" -m "hil-forceps $version"
echo "release: v$version is committed and tagged; the wheel is in dist/. Push with: git push --follow-tags"
