"""The user's own scripts are told from what is installed, and from options."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.measuring.own_scripts import scripts_in

if TYPE_CHECKING:
    from pathlib import Path


def test_scripts_are_told_from_options_and_inline_programs() -> None:
    assert list(scripts_in(["bash", "-x", "plan.sh", "more.sh"])) == ["plan.sh"]
    assert list(scripts_in(["/usr/bin/python3.11", "-m", "plan"])) == []
    assert list(scripts_in(["bin/plan", "hall"])) == ["bin/plan"]


def test_the_python_of_a_virtual_environment_is_no_file_of_the_experiment(tmp_path: Path) -> None:
    (tmp_path / "pyvenv.cfg").touch()
    python, plan = str(tmp_path / "bin" / "python"), str(tmp_path / "bin" / "plan")
    assert list(scripts_in([python, "talker.py"])) == ["talker.py"], "elsewhere it would find none of its packages"
    assert list(scripts_in([plan, "hall"])) == [plan]
