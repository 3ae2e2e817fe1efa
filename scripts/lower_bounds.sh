#!/bin/sh
# Execute the tests with the oldest releases that pyproject.toml allows, in an environment of their own.
#
# An old library's warnings of what is to come are not failures here; those of the locked ones are, in `make test`.
set -eu
cd "$(dirname "$0")/.."
old=.make/lower-bounds

.venv/bin/uv venv --quiet --clear --seed --python .venv/bin/python "$old"
.venv/bin/uv pip install --quiet --python "$old/bin/python" --resolution lowest-direct --editable '.[dev]'
"$old/bin/python" scripts/execute_tests.py -m "not soak" --override-ini filterwarnings=default "$@"
