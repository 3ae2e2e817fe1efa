#!/bin/sh
# Let .venv import Debian's ROS 1, for the tests: a .pth file puts the system's packages after the environment's own.
#
# A PYTHONPATH would put them before, where Debian's older releases hide what the environment has.
set -eu
cd "$(dirname "$0")/.."
system=/usr/lib/python3/dist-packages

minor() {
    "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])'
}

[ -x .venv/bin/python ] || exit 0
site=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
if [ -d "$system/rospy" ] && [ "$(minor .venv/bin/python)" = "$(minor /usr/bin/python3)" ]; then
    printf '%s\n' "$system" >"$site/debian_ros.pth"
else
    rm -f "$site/debian_ros.pth"
fi
