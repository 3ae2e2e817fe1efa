"""The user's own scripts are told from what is installed, and from options."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robot_runner.core.storage.input_files import InputFile
from robot_runner.measuring.own_scripts import script_inputs, scripts_in, unread_findings


def test_scripts_are_told_from_options_and_inline_programs() -> None:
    assert list(scripts_in(["bash", "-x", "plan.sh", "more.sh"])) == ["plan.sh"]
    assert list(scripts_in(["/usr/bin/python3.11", "-m", "plan"])) == []
    assert list(scripts_in(["bin/plan", "hall"])) == ["bin/plan"]


@pytest.mark.parametrize(
    ("command", "script"),
    [
        ("python3 -W ignore meter.py", "meter.py"),
        ("python3 -Wignore -X dev meter.py", "meter.py"),
        ("python3 -uEW once meter.py", "meter.py"),
        ("python3 -- meter.py", "meter.py"),
        ("python3 -uc print()", ""),
        ("bash -e run.sh", "run.sh"),
        ("sh -xeu run.sh", "run.sh"),
        ("bash -eo pipefail run.sh", "run.sh"),
        ("bash +x run.sh", "run.sh"),
        ("bash -lc meter.sh", ""),
        ("sh -s hall", ""),
        ("perl -Mstrict -w meter.pl", "meter.pl"),
        ("perl -ne print meter.txt", ""),
        ("node --inspect meter.js", "meter.js"),
        ("sudo -n python3 meter.py", "meter.py"),
        ("nice -n 5 ./meter", "./meter"),
        ("env RATE=/10 nice python3 -u meter.py", "meter.py"),
        ("sudo -u pi timeout 10 /usr/bin/python3 meter.py", "meter.py"),
        ("uv run meter.py --csv", "meter.py"),
        ("uv run --with numpy python3 -u meter.py", "meter.py"),
        ("conda run -n lab python meter.py", "meter.py"),
        ("uv run -m meter", ""),
        ("timeout 10 wattmeter --csv", ""),
        ("wattmeter python3 meter.py", ""),
    ],
)
def test_the_script_is_found_behind_options_with_values_and_behind_wrappers(command: str, script: str) -> None:
    assert list(scripts_in(command.split())) == [script] * bool(script)


def test_the_python_of_a_virtual_environment_is_no_file_of_the_experiment(tmp_path: Path) -> None:
    (tmp_path / "pyvenv.cfg").touch()
    python, plan = str(tmp_path / "bin" / "python"), str(tmp_path / "bin" / "plan")
    assert list(scripts_in([python, "talker.py"])) == ["talker.py"], "elsewhere it would find none of its packages"
    assert list(scripts_in([plan, "hall"])) == [plan]


def test_a_program_that_may_be_executed_and_not_read_is_no_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unread, read = tmp_path / "meter", tmp_path / "planner"
    read.touch()
    unread.touch()
    monkeypatch.setattr(os, "access", lambda path, _mode: path != unread)  # as for users other than root
    assert list(script_inputs([unread, read])) == [InputFile(read)]
    (told,) = unread_findings("plugin Meter", [unread, read])
    assert (told.is_error, told.problem) == (False, f"the program {str(unread)!r} cannot be read: a package lacks it")


def test_of_a_folder_that_is_executed_no_results_and_no_compiled_modules_are_meant(tmp_path: Path) -> None:
    # They are written meanwhile: what runs before have read would be another file whenever the experiment goes on.
    for name in ("__main__.py", "parts.py", "__pycache__/parts.pyc", "results/manifest.json", "results/run_table.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (found,) = script_inputs([tmp_path])
    assert found == InputFile(tmp_path, (tmp_path / "__main__.py", tmp_path / "parts.py"))
