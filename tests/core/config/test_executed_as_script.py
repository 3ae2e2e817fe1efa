"""`python study.py` only defines a class: it says how the experiment is executed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from tests.conftest import written_config

TOLD = "python has only defined the experiment in {0}; `robot-runner {0}` executes it\n"


def said_by(folder: Path, *words: str) -> str:
    done = subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True, timeout=60, check=True)
    assert not done.stdout
    return done.stderr


@pytest.mark.long
def test_a_config_that_python_executes_says_that_nothing_was_executed(tmp_path: Path) -> None:
    config = written_config(tmp_path)
    derived = "\n\nclass Again(RobotRunnerConfig):\n    pass\n"
    config.write_text(config.read_text(encoding="utf-8") + derived, encoding="utf-8")
    assert said_by(tmp_path, "config.py") == TOLD.format("config.py")
    (tmp_path / "config.py").rename(tmp_path / "my config.py")
    assert said_by(tmp_path, "my config.py") == TOLD.format("'my config.py'")


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ("-c", "import config"),
        ("-c", "import config, pickle; assert pickle.loads(pickle.dumps(config.RobotRunnerConfig))"),
        ("-c", "from robot_runner import ExperimentConfig\nclass Mine(ExperimentConfig): pass"),
        ("script.py",),
    ],
)
def test_a_config_that_is_imported_or_executed_by_a_script_says_nothing(tmp_path: Path, words: tuple[str, ...]) -> None:
    config = written_config(tmp_path).read_text(encoding="utf-8")
    script = f"{config}\n\nif __name__ == '__main__':\n    run_experiment(RobotRunnerConfig, say=lambda text: None)\n"
    (tmp_path / "script.py").write_text(script, encoding="utf-8")
    assert "only defined" not in said_by(tmp_path, *words)


@pytest.mark.long
def test_a_script_that_executes_its_config_in_another_way_is_told_nothing(tmp_path: Path) -> None:
    """What such a block does cannot be known, such as to start robot-runner."""
    config = written_config(tmp_path)
    block = "\n\nif '__main__' == __name__:\n    import subprocess\n    subprocess.run(['true'])\n"
    config.write_text(config.read_text(encoding="utf-8") + block, encoding="utf-8")
    assert not said_by(tmp_path, "config.py")


@pytest.mark.long
def test_a_config_that_is_piped_into_python_says_nothing_as_there_is_no_file_to_name(tmp_path: Path) -> None:
    with written_config(tmp_path).open(encoding="utf-8") as config:
        done = subprocess.run([sys.executable], stdin=config, capture_output=True, text=True, timeout=60, check=True)
    assert not done.stderr


@pytest.mark.long
def test_a_program_without_arguments_may_define_a_config(tmp_path: Path) -> None:
    """As one that embeds Python."""
    config = written_config(tmp_path).read_text(encoding="utf-8")
    (tmp_path / "config.py").write_text(f"import sys\ndel sys.argv[:]\n{config}", encoding="utf-8")
    assert "only defined" in said_by(tmp_path, "config.py")
