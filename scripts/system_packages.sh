#!/bin/sh
# What the tests need of the system beside Python: an SSH server, a compiler and a simulator for the firmware, a browser.
#
# On Debian as root it is installed. Elsewhere the tests that need it are skipped, and this says what is missing.
set -u
trap 'sh "$(dirname "$0")/debian_ros.sh"' EXIT
packages="openssh-server openssh-client gcc-avr avr-libc simavr libsimavr-dev gcc libc6-dev libelf-dev chromium tshark busybox dosfstools arduino-core-avr mtools linux-perf python3-rospy python3-rosmaster python3-rosbag python3-roslaunch python3-rosgraph python3-rosnode python3-rostopic python3-rosservice python3-geometry-msgs python3-nav-msgs python3-sensor-msgs python3-std-msgs python3-std-srvs python3-rosgraph-msgs python3-tf2-msgs catkin"

command -v dpkg-query >/dev/null 2>&1 || {
    echo "This is no Debian: tests that need one of these programs are skipped: $packages"
    exit 0
}
missing=
for package in $packages; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing="$missing $package"
done
[ -z "$missing" ] && exit 0
if [ "$(id -u)" -ne 0 ]; then
    echo "Not installed, so the tests that need them are skipped (sudo apt install$missing)"
    exit 0
fi
echo "installing Debian packages that the tests need:$missing"
export DEBIAN_FRONTEND=noninteractive
log=$(mktemp)
# One that cannot be had does not keep the others out.
if ! { apt-get -q update && apt-get install -q -y --no-install-recommends $missing; } >"$log" 2>&1; then
    for package in $missing; do
        apt-get install -q -y --no-install-recommends "$package" >"$log" 2>&1 ||
            echo "$package could not be installed: the tests that need it are skipped"
    done
fi
rm -f "$log"
