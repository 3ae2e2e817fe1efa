#!/bin/sh
# What the tests need of the system beside Python: an SSH server, a compiler and a simulator for the firmware, a browser, an MQTT broker, R, zsh, fish, Fast DDS.
#
# On Debian as root it is installed, after saying so. Elsewhere, and with ROBOT_RUNNER_SYSTEM_PACKAGES=no, nothing is
# installed: the tests that need a missing package are skipped, and this says which packages are missing.
set -u
cd "$(dirname "$0")/.." || exit 1
trap 'sh scripts/debian_ros.sh' EXIT
packages="openssh-server openssh-client gcc-avr avr-libc simavr libsimavr-dev gcc libc6-dev libelf-dev chromium tshark ffmpeg busybox dosfstools arduino-core-avr mtools linux-perf mosquitto openssl r-base-core r-cran-nlme python3-rospy python3-actionlib python3-rosmaster python3-rosbag python3-roslaunch python3-rosgraph python3-rosnode python3-rostopic python3-rosservice python3-geometry-msgs python3-nav-msgs python3-sensor-msgs python3-std-msgs python3-std-srvs python3-rosgraph-msgs python3-tf2-msgs catkin zsh fish g++ libfastrtps-dev"
skipped="The tests that need them are skipped; each is listed with its reason at the end."

say() {
    printf 'robot-runner: %s\n' "$@"
}

case ${ROBOT_RUNNER_SYSTEM_PACKAGES:-yes} in
    yes | no) ;;
    *)
        say "ROBOT_RUNNER_SYSTEM_PACKAGES=$ROBOT_RUNNER_SYSTEM_PACKAGES means nothing." "Set it to no, or leave it out." >&2
        exit 1
        ;;
esac
command -v dpkg-query >/dev/null 2>&1 || {
    say "this is not Debian, so nothing is installed of the system. The tests can use these Debian packages: $packages" "$skipped"
    exit 0
}
missing=
for package in $packages; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing="$missing $package"
done
[ -z "$missing" ] && exit 0
if [ "${ROBOT_RUNNER_SYSTEM_PACKAGES:-yes}" = no ]; then
    say "not installed, as ROBOT_RUNNER_SYSTEM_PACKAGES=no asks:$missing" "$skipped"
    exit 0
fi
if [ "$(id -u)" -ne 0 ]; then
    say "not installed:$missing" "$skipped To install them: sudo apt install$missing"
    exit 0
fi
say "about to install these Debian packages on this machine, which the tests need:$missing" \
    "To go without them, set ROBOT_RUNNER_SYSTEM_PACKAGES=no: the tests that need them are then skipped."
if [ -t 0 ] && [ -t 1 ]; then
    say "Installing starts in 10 s; Ctrl-C stops it."
    sleep 10
fi
export DEBIAN_FRONTEND=noninteractive
# Meanwhile set_up.sh may install what Python lacks for a virtual environment.
if command -v flock >/dev/null 2>&1; then
    mkdir -p .make
    exec 8>.make/apt
    flock 8
fi
log=$(mktemp)
# One that cannot be had does not keep the others out.
# shellcheck disable=SC2086  # several words on purpose
if ! { apt-get -q update && apt-get install -q -y --no-install-recommends $missing; } >"$log" 2>&1; then
    for package in $missing; do
        apt-get install -q -y --no-install-recommends "$package" >"$log" 2>&1 ||
            say "$package could not be installed: the tests that need it are skipped"
    done
fi
rm -f "$log"
