#!/bin/sh
# Write requirements/ anew: the newest releases that pyproject.toml allows, with hashes, for every Python and system.
set -eu
cd "$(dirname "$0")/.."

# Usage: lock FILE OPTION... Addresses of package indexes stay out: where packages come from is the installer's affair.
lock() {
    file=$1
    shift
    .venv/bin/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes \
        --no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" \
        --group build --output-file "$file" pyproject.toml "$@"
}

mkdir -p requirements
lock requirements/test.txt --extra dev
# Within the versions of the tests, so that `make test` after `make demo` changes none.
# Beside the robot: what packs, replicates and compares its experiment.
lock requirements/demo.txt --extra sim --extra analysis --extra replication --constraint requirements/test.txt
# Beside what the tests have: a ROS 2 of its own.
.venv/bin/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes \
    --no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" \
    --group ros2 --constraint requirements/test.txt --output-file requirements/ros2.txt
