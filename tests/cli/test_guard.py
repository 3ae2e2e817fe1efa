from __future__ import annotations

import errno
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.command_line import PROGRAM
from tests.long_cases import soak_but

from robot_runner.cli.guard import guarded
from robot_runner.core.errors import ConfigError, Finding, LinkError

if TYPE_CHECKING:
    from collections.abc import Callable


def raising(error: BaseException) -> Callable[[], int]:
    def command() -> int:
        raise error

    return command


def test_the_code_of_a_command_is_passed_on() -> None:
    assert guarded(lambda: 7) == 7


def test_an_error_is_a_problem_a_place_and_a_fix(capsys: pytest.CaptureFixture[str]) -> None:
    code = guarded(raising(LinkError("no odometry came", where="robot alice", fix="Switch it on.")))
    assert code == 2
    assert capsys.readouterr().err == "error: robot alice: no odometry came\n  fix: Switch it on.\n"


def test_many_findings_are_all_shown_errors_first_and_counted(capsys: pytest.CaptureFixture[str]) -> None:
    findings = [
        Finding.warning("b.py", "odd", "Look."),
        Finding.error("a.py", "wrong", "Correct it."),
        Finding.error("a.py", "two\nlines \x1b[31mred", "Correct it."),
    ]
    assert guarded(raising(ConfigError.of_findings(findings))) == 2
    said = capsys.readouterr().err.splitlines()
    assert [line for line in said if not line.startswith("  ")] == [
        "error: a.py: wrong",
        "error: a.py: two\\nlines \\x1b[31mred",
        "warning: b.py: odd",
        "2 errors, 1 warning.",
    ]


def test_ctrl_c_before_anything_was_executed_is_130(capsys: pytest.CaptureFixture[str]) -> None:
    assert guarded(raising(KeyboardInterrupt())) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_a_fault_of_our_own_is_said_to_be_ours_and_kept(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert guarded(raising(ZeroDivisionError("by nought"))) == 70
    said = capsys.readouterr().err
    assert said.startswith("error: this is a fault of Robot Runner, not yours: ZeroDivisionError: by nought\n")
    assert "Traceback" not in said
    kept = re.search(r"the file (.+\.txt)", " ".join(said.split()))
    assert kept is not None
    assert "ZeroDivisionError: by nought" in Path(kept.group(1)).read_text(encoding="utf-8")


def test_what_is_kept_of_a_fault_to_be_reported_has_no_secret(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("LAB_TOKEN", "open-sesame")
    assignments = ["--set", "db_password=swordfish", "--set=wifi_psk=wander lust", "--set", "robot=simulated"]
    monkeypatch.setattr(sys, "argv", ["robot-runner", "study.py", *assignments])
    assert guarded(raising(ZeroDivisionError("by open-sesame"))) == 70
    assert "open-sesame" not in capsys.readouterr().err
    (kept,) = tmp_path.iterdir()
    lines = kept.read_text(encoding="utf-8").splitlines()
    assert lines[1] == "robot-runner study.py --set db_password=... --set wifi_psk=... --set robot=simulated"
    assert lines[-1] == "ZeroDivisionError: by REDACTED"


def test_output_for_which_a_disk_has_no_room_is_no_fault_of_ours(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert guarded(lambda: 0 * sys.stdout.write("a line\n")) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: the output cannot be written: No space left on device\n")


@pytest.mark.parametrize(
    ("command", "code"),
    [(lambda: 0 * sys.stderr.write("figures: 3 of 16\n"), 0), (raising(ConfigError("no", where="x", fix="y")), 2)],
    ids=["progress", "refusal"],
)
def test_errors_and_progress_for_which_a_disk_has_no_room_change_no_exit_code(
    monkeypatch: pytest.MonkeyPatch, command: Callable[[], int], code: int
) -> None:
    with Path("/dev/full").open("w", buffering=1, encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stderr", full)
        assert guarded(command) == code


def test_a_current_folder_that_was_removed_is_no_fault_of_ours(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert guarded(lambda: len(str(Path.cwd()))) == 2
    said = capsys.readouterr().err
    assert said == "error: the current folder was removed or renamed\n  fix: Go to one that is there: cd FOLDER.\n"


def test_what_the_system_refuses_of_a_file_is_no_fault_of_ours(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))  # the last one is our fault, whose traceback is kept
    refused = PermissionError(errno.EACCES, "Permission denied", "/lab/study/manifest.json")
    assert guarded(raising(refused)) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: /lab/study/manifest.json: the file cannot be opened: Permission denied\n  fix: ")
    assert guarded(raising(PermissionError("nobody may"))) == 70


@pytest.mark.parametrize("number", [errno.ENOTCONN, errno.ESTALE, errno.EIO, errno.EHOSTDOWN])
def test_a_disk_or_network_folder_that_went_away_is_no_fault_of_ours(
    number: int, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = OSError(number, os.strerror(number), "/media/stick/study/stop")
    assert guarded(raising(gone)) == 2
    assert capsys.readouterr().err == (
        f"error: /media/stick/study/stop: the file cannot be opened: {os.strerror(number)}\n"
        "  fix: See that its disk or network folder is there again, and sound; then try again.\n"
    )


def test_that_no_folder_takes_temporary_files_is_no_fault_of_ours(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr("tempfile._candidate_tempdir_list", lambda: ["/proc"])
    assert guarded(lambda: len(tempfile.gettempdir())) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: no folder takes temporary files: No usable temporary directory found in ['/proc']\n")
    assert "TMPDIR" in said


def test_that_memory_is_lacking_is_no_fault_of_ours(capsys: pytest.CaptureFixture[str]) -> None:
    def greedy() -> int:
        return len(bytearray(sys.maxsize))

    assert guarded(greedy) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: this machine: there is not enough memory for this\n  fix: ")
    assert guarded(raising(MemoryError("Unable to allocate 8.00 GiB for an array"))) == 2
    assert "for this: Unable to allocate 8.00 GiB for an array\n" in capsys.readouterr().err
    assert guarded(greedy, show_traceback=True) == 2
    assert "in greedy" in capsys.readouterr().err


def test_a_fault_is_said_even_where_nothing_can_be_kept(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    assert guarded(raising(ZeroDivisionError("by nought"))) == 70
    assert "fix: Repeat the command with --debug, and report it" in capsys.readouterr().err


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert guarded(raising(ZeroDivisionError("by nought")), show_traceback=True) == 70
    assert "Traceback (most recent call last)" in capsys.readouterr().err
    assert guarded(raising(LinkError("no odometry came")), show_traceback=True) == 2
    assert "Traceback (most recent call last)" in capsys.readouterr().err


@pytest.mark.long
def test_a_reader_that_has_read_enough_is_no_error(program: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)  # before the program, which may write all that it has before anybody reads it
    with os.fdopen(writer, "wb") as output:
        ended = subprocess.run(
            [program, "plugins", "--json"], stdout=output, stderr=subprocess.PIPE, check=False, timeout=60
        )
    assert (ended.returncode, ended.stderr) == (141, b"")


@pytest.mark.long
def test_colour_is_for_terminals_alone(program: str, tmp_path: Path) -> None:
    answer = subprocess.run([program, "check", "x.py"], cwd=tmp_path, capture_output=True, check=False)
    assert answer.returncode == 2
    assert b"\x1b" not in answer.stdout + answer.stderr


@pytest.mark.long
def test_a_terminal_without_unicode_is_no_fault(program: str, tmp_path: Path) -> None:
    (tmp_path / "ä.py").write_text("1 +", encoding="utf-8")
    environment = {"PYTHONIOENCODING": "ascii", "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    answer = subprocess.run(
        [program, "check", "ä.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert answer.returncode == 2
    assert "?.py is refused: 1 error." in answer.stdout


@pytest.mark.long
@pytest.mark.parametrize("closed", soak_but({">&-", "<&- >&- 2>&-"}, ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"]))
def test_streams_that_are_closed_hold_nothing_up_and_get_no_file_of_the_experiment(
    write_config: Callable[..., Path], closed: str
) -> None:
    config = write_config("def launch_mission(self, context): import os; os.write(1, b'x'); os.write(2, b'y')")
    command = f'exec "$@" {closed}'
    done = subprocess.run(["sh", "-c", command, "sh", PROGRAM, "run", str(config)], check=False, timeout=120)
    assert done.returncode == 0
    folder = config.parent / "results" / "trial"
    kinds = [json.loads(line)["kind"] for line in (folder / "journal.jsonl").read_text().splitlines()]
    assert kinds[-1] == "experiment_finished"
    assert "xy" in (folder / "runs" / "r_1" / "log.txt").read_text()
