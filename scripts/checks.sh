#!/bin/sh
# Every check and the tests, the same for a person and for CI. Usage: checks.sh quick|all
#
# TESTS=all executes the tests that are marked `long`, too.
# All steps are taken, also after one has failed; the exit code is 0 only when none did.
set -u
cd "$(dirname "$0")/.." || exit 1
bin=.venv/bin
code="src tests benchmarks scripts examples robot" # results of experiments may lie beside them
failed=

# Take one step; what it says is shown when it fails.
step() {
    name=$1
    shift
    if output=$("$@" 2>&1); then
        printf '  ok      %s\n' "$name"
    else
        printf '  FAILED  %s\n' "$name"
        printf '%s\n' "$output"
        failed="$failed, $name"
    fi
}

# The steps that take longest after the tests. The first of them needs a minute of one processor in a fresh clone.
take_slow_steps() {
    step "types" "$bin/mypy"
    step "import contracts" "$bin/lint-imports"
    [ "$which" = all ] || return 0
    step "command-line page is current" "$bin/python" scripts/generate_cli_page.py --check
}

which=${1:-all}
case "${TESTS:-}" in
    all) marks="not soak" ;;
    "") marks="not soak and not long" ;;
    *)
        printf 'robot-runner: TESTS=%s is not known. Leave it out, or say TESTS=all for the long tests, too.\n' "$TESTS" >&2
        exit 2
        ;;
esac
# shellcheck disable=SC2086  # several words on purpose
step "format" "$bin/ruff" format --check $code
# shellcheck disable=SC2086  # likewise
step "lint" "$bin/ruff" check $code
step "shell scripts" "$bin/shellcheck" scripts/*.sh .ci/run
if [ "$which" = all ]; then
    # Tests wait a third of their time for processes, robots and clocks: the slow steps fill those gaps.
    mkdir -p .make
    {
        take_slow_steps
        printf '%s' "$failed" >.make/failed-steps
    } >.make/slow-steps 2>&1 &
    beside=$!
    trap 'kill "$beside"; exit 130' INT TERM
    tests=
    "$bin/python" scripts/execute_tests.py -m "$marks" || tests=", tests"
    wait "$beside" || tests="$tests, steps beside the tests"
    cat .make/slow-steps
    failed="$(cat .make/failed-steps)$tests"
else
    take_slow_steps
fi
if [ -n "$failed" ]; then
    printf 'Failed: %s.\n' "${failed#, }"
    exit 1
fi
printf 'Everything passed.\n'
