#!/bin/sh
# Build the source distribution and the wheel into dist/, never under a tag that is not the project's version.
#
# TAG names the tag to release; without it, one that HEAD carries is looked for. Without any, this is a trial build.
set -eu
cd "$(dirname "$0")/.."

tag=${TAG:-$(git describe --tags --exact-match --match 'v*' 2>/dev/null || true)}
version=$(.venv/bin/hatchling version)
if [ -n "$tag" ] && [ "$tag" != "v$version" ]; then
    printf 'robot-runner: the tag is %s, but pyproject.toml says version %s.\n' "$tag" "$version" >&2
    printf 'robot-runner: Set the version there, in CITATION.cff, CHANGELOG.md and robot/, commit, then tag that commit v%s.\n' "$version" >&2
    exit 1
fi
rm -rf dist
.venv/bin/hatchling build
