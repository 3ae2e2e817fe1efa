from __future__ import annotations

import io
import shutil
import subprocess
from pathlib import Path

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links import ssh_command as module
from robot_runner.core.links.ssh_command import for_any_shell, passes_login, remedy, ssh_command, ssh_findings

#: What shells understand in their own ways, also within single quotes.
AWKWARD = "printf '%s|' 'a\\\\b' \"it's\" 'c!d' 't\\' 'x\ny' 'é' '$HOME' '~'; cat"


def test_the_client_never_asks_and_the_users_own_config_applies():
    command = ssh_command("pi@robot", "true")
    assert command[0] == "ssh"
    assert "BatchMode=yes" in command
    assert "-F" not in command
    assert command[-3:] == ["--", "pi@robot", for_any_shell("true")]


def test_a_config_of_the_experiment_takes_the_place_of_the_users():
    assert ssh_command("robot", "true", config=Path("lab/ssh_config"))[1:3] == ["-F", "lab/ssh_config"]


@pytest.mark.parametrize("shell", ["sh", "bash", "dash", "zsh", "mksh", "busybox sh", "fish", "tcsh", "csh"])
def test_a_command_means_the_same_whatever_the_login_shell(shell):
    program, *words = shell.split()
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    command = [program, *words, "-c", for_any_shell(AWKWARD)]
    done = subprocess.run(command, input=b"in", capture_output=True, check=True, timeout=30)
    said = io.BytesIO(done.stdout)
    assert passes_login(said)
    assert said.read().decode() == "a\\\\b|it's|c!d|t\\|x\ny|é|$HOME|~|in"


def test_a_command_has_nothing_that_shells_understand_in_their_own_ways():
    quoted = for_any_shell(AWKWARD).split("'")
    assert len(quoted) == 5  # two words in single quotes, and none within them
    assert not set("\\!\n").intersection(quoted[1])
    assert not set("!\n").intersection(quoted[3])
    assert "\\\\" not in quoted[3]
    assert quoted[3].isascii()


def test_what_a_login_writes_before_a_command_is_told_apart():
    command = "printf 'Welcome\\nrobot'; " + for_any_shell("echo 5")
    done = subprocess.run(["sh", "-c", command], capture_output=True, check=True, timeout=30)
    said = io.BytesIO(done.stdout)
    assert passes_login(said)
    assert said.read() == b"5\n"
    assert not passes_login(io.BytesIO(b"This account is not available.\n"))


@pytest.mark.parametrize("host", ["", "-oProxyCommand=touch x", "a b", "a\nb", 5])
def test_a_host_that_would_pass_for_something_else_is_refused(host):
    with pytest.raises(LinkError, match="not a host that ssh could connect to"):
        ssh_command(host, "true")
    (finding,) = ssh_findings("plugin PsUtil", host)
    assert finding.is_error
    assert finding.fix


@pytest.mark.parametrize(
    ("complaint", "fix"),
    [
        ("pi@robot: Permission denied (publickey,password).", "ssh-copy-id pi@robot"),
        ("pi@robot: Permission denied (publickey).", "passphrase into the agent: ssh-add"),
        ("Host key verification failed.", "say yes to its key: ssh pi@robot"),
        ("WARNING: REMOTE HOST IDENTIFICATION HAS CHANGED!\nHost key verification failed.", "may be an attack"),
        ("ssh: Could not resolve hostname robot: Name or service not known", "Look at the name"),
        ("ssh: connect to host robot port 22: Connection refused", "Start the SSH server"),
        ("ssh: connect to host robot port 22: Connection timed out", "switched on"),
        ("something new", "ssh pi@robot true"),
    ],
)
def test_what_ssh_complains_of_has_a_remedy(complaint, fix):
    assert fix in remedy("pi@robot", complaint)


def test_what_is_to_be_tried_by_hand_has_the_config_of_the_experiment():
    assert "ssh -F 'my lab/ssh_config' robot true" in remedy("robot", "?", config=Path("my lab/ssh_config"))


def test_a_machine_without_ssh_is_told_how_to_get_it(monkeypatch):
    monkeypatch.setattr(module.shutil, "which", lambda _: None)
    (finding,) = ssh_findings("plugin PsUtil", "robot")
    assert "not installed" in finding.problem
    assert "openssh-client" in finding.fix


def test_a_config_that_is_not_there_is_a_finding(monkeypatch, tmp_path):
    monkeypatch.setattr(module.shutil, "which", lambda _: "/usr/bin/ssh")
    (finding,) = ssh_findings("plugin PsUtil", "robot", config=tmp_path / "nothing")
    assert "there is no ssh config" in finding.problem
