"""What an experiment has claimed is refused to another one, until it ends, however it ends."""

from __future__ import annotations

import errno
import fcntl
import json
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote

import pytest

from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.storage import claim_locks
from robot_runner.core.storage.claim_locks import HeldClaims, claim_holders, claiming_folders, state_folder

HOLDING = """
import sys, time
from pathlib import Path
from robot_runner.core.storage.claim_locks import HeldClaims
with HeldClaims(["serial:/dev/ttyUSB0", "robot:ros2://alice"], "first", Path("/results/first")):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def _own_state(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def test_a_second_experiment_is_refused_with_the_name_of_the_first_until_that_is_killed() -> None:
    first = subprocess.Popen([sys.executable, "-c", HOLDING], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        with (
            pytest.raises(ExecutionError) as refused,
            HeldClaims(["robot:ros2://alice", "serial:/dev/ttyUSB0", "host:pi@bob"], "second", Path("second")),
        ):
            raise AssertionError("it was not refused")
        assert [finding.problem.split(" (")[0] for finding in refused.value.findings] == [
            f"{claim} is in use by the experiment 'first' in /results/first"
            for claim in ("robot:ros2://alice", "serial:/dev/ttyUSB0")
        ]
        assert str(first.pid) in str(refused.value)
        with HeldClaims(["host:pi@bob"], "third", Path("third")):
            pass  # what the refused one had got was let go of
    finally:
        first.kill()
        first.communicate()
    with HeldClaims(["serial:/dev/ttyUSB0", "robot:ros2://alice"], "second", Path("second")) as held:
        assert held.findings == []


def _started_again() -> int:
    """Start the first experiment again, to its end, and return the exit code."""
    return subprocess.run([sys.executable, "-c", HOLDING], check=False, stdin=subprocess.DEVNULL, timeout=60).returncode


def test_who_waits_for_what_is_left_of_an_experiment_does_not_keep_that_from_being_started_again() -> None:
    assert _started_again() == 0
    codes: list[int] = []

    def goes_on(folder: Path) -> bool:
        codes.append(_started_again())
        return True

    waiting = HeldClaims(["serial:/dev/ttyUSB0"], "second", Path("/results/second"), None, goes_on)
    with pytest.raises(ExecutionError, match="in use by the remaining processes of the experiment 'first'"), waiting:
        pass
    assert codes == [0]


def test_who_has_taken_a_claim_while_its_last_holder_was_looked_at_is_looked_at_as_well() -> None:
    assert _started_again() == 0
    looked: list[Path] = []

    def goes_on(folder: Path) -> bool:
        looked.append(folder)
        if len(looked) == 1:
            assert _started_again() == 0
        return False

    with HeldClaims(["serial:/dev/ttyUSB0"], "second", Path("/results/second"), None, goes_on):
        pass
    assert looked == [Path("/results/first")] * 2


def test_where_claims_cannot_be_written_it_is_said_and_nothing_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with HeldClaims(["device:camera 0"], "one", tmp_path) as held:
        assert "other experiments that claim device:camera 0 are not kept out" in held.findings[0].problem


def test_a_link_in_the_place_of_a_claim_is_not_followed(tmp_path: Path) -> None:
    with HeldClaims(["serial:a"], "one", tmp_path):
        pass
    path = next((tmp_path / "state").rglob("serial*"))
    path.unlink()
    path.symlink_to(tmp_path / "elsewhere")
    with HeldClaims(["serial:a"], "one", tmp_path) as held:
        assert held.findings
    assert not (tmp_path / "elsewhere").exists()


def test_a_claim_is_held_where_there_is_no_room_to_say_who_holds_it(tmp_path: Path) -> None:
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, unlimited[1]))  # as on a full disk
    try:
        with HeldClaims(["serial:a"], "one", tmp_path) as held:
            script = (
                "from robot_runner.core.storage.claim_locks import claim_holders; print(claim_holders(['serial:a']))"
            )
            asked = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    assert held.findings == []
    assert "another one" in asked.stdout


def test_where_the_file_system_has_no_locks_it_is_said_and_nothing_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "lockf", refuse)
    with HeldClaims(["serial:a"], "one", tmp_path) as held:
        assert "other experiments that claim serial:a are not kept out" in held.findings[0].problem
        assert "No locks available" in held.findings[0].problem
    assert claim_holders(["serial:a"]) == {}


def test_a_user_without_a_home_folder_is_told_what_to_set(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", "")
    monkeypatch.setattr(Path, "expanduser", _without_home)
    with pytest.raises(StorageError, match="XDG_STATE_HOME"):
        state_folder("queue")
    with HeldClaims(["serial:a"], "one", tmp_path) as held:
        assert "no home folder" in held.findings[0].problem
    assert claim_holders(["serial:a"]) == {}


def _without_home(path: Path) -> Path:
    raise RuntimeError(f"Could not determine home directory of {path}.")


def test_a_whole_graph_and_a_robot_on_it_are_not_claimed_at_the_same_time() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLDING], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        for claim in ("robot:ros2:/", "robot:ros2://alice/arm"):
            with (
                pytest.raises(ExecutionError, match="may be one robot with robot:ros2://alice, which is in use by"),
                HeldClaims([claim], "second", Path("/results/second")),
            ):
                pass
        with HeldClaims(["robot:ros2://bob", "robot:ros2://alic"], "third", Path("/results/third")):
            pass
        first.communicate()


def _looked_at(claims: list[str], name: str, *, has_seen_to_it: bool = False) -> list[str]:
    """Have an experiment claim something, and return of which others it has looked whether anything goes on."""
    looked: list[str] = []
    with HeldClaims(claims, name, Path(name), None, lambda root: bool(looked.append(root.name))) as held:
        if has_seen_to_it:
            held.forget_earlier()
    return looked


@pytest.mark.parametrize("claim", ["robot:domain 7/alice", "robot:domain 7"], ids=["the robot", "its whole graph"])
def test_a_killed_experiment_is_looked_at_until_what_it_left_was_seen_to_whoever_is_refused_or_dies_before(
    tmp_path: Path, claim: str
) -> None:
    killed = tmp_path / "killed"
    killed.mkdir()
    with HeldClaims(["robot:domain 7/alice"], "killed", killed):
        pass
    with subprocess.Popen([sys.executable, "-c", HOLDING], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as first:
        assert first.stdout is not None
        first.stdout.readline()
        with pytest.raises(ExecutionError, match="serial:/dev/ttyUSB0 is in use"):
            _looked_at([claim, "serial:/dev/ttyUSB0"], "refused")
        first.communicate()
    assert "killed" in _looked_at([claim], "dies")
    assert killed in claiming_folders()


def test_a_robot_is_refused_while_something_is_left_of_a_killed_experiment_that_had_its_whole_graph(
    tmp_path: Path,
) -> None:
    _looked_at(["robot:domain 7"], "killed")
    claims = HeldClaims(["robot:domain 7/alice"], "second", tmp_path / "second", None, Path("killed").__eq__)
    with (
        pytest.raises(ExecutionError, match="in use by the remaining processes of the experiment 'killed'"),
        claims,
    ):
        pass


def test_of_what_was_seen_to_nothing_is_looked_at_any_more() -> None:
    claims = ["robot:domain 7/alice"]
    _looked_at(claims, "killed")
    assert _looked_at(claims, "second", has_seen_to_it=True) == ["killed"]
    assert _looked_at(claims, "third") == ["second"]


@pytest.mark.parametrize("folder", ["x" * 5000, "a\0b", "\ud800", ""])
def test_a_claim_whose_file_names_a_folder_that_cannot_be_looked_at_can_be_held(tmp_path: Path, folder: str) -> None:
    with HeldClaims(["host:pi"], "first", tmp_path):
        pass
    (file,) = state_folder("claims").iterdir()
    told = {"experiment": "first", "folder": folder, "pid": 1, "since": "", "before": [folder]}
    file.write_text(json.dumps(told))
    assert claiming_folders() == []
    with HeldClaims(["host:pi"], "second", tmp_path) as held:
        assert held.findings == []


def _holding_under_another_name() -> subprocess.Popen[str]:
    """Start an experiment as a machine does whose name was another one, by DHCP say, and which holds its claims."""
    script = f"import socket; socket.gethostname = lambda: 'dhcp-77'\n{HOLDING}"
    first = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert first.stdout is not None
    assert first.stdout.readline() == "held\n"
    return first


def test_what_this_machine_has_claimed_under_another_name_is_refused() -> None:
    """Two experiments commanded one robot where the name of the machine had changed between their starts."""
    first = _holding_under_another_name()
    try:
        for claim, said in (("robot:ros2://alice", ""), ("robot:ros2://alice/arm", "may be one robot with robot:")):
            with pytest.raises(ExecutionError, match=f"{said}.*in use by the experiment 'first'"):
                HeldClaims([claim], "second", Path("second")).__enter__()
        assert claim_holders(["robot:ros2://alice"])["robot:ros2://alice"].pid == first.pid
    finally:
        first.kill()
        first.communicate()
    with HeldClaims(["robot:ros2://alice"], "second", Path("second")) as held:
        assert held.findings == []
    left = HeldClaims(["robot:ros2://alice"], "second", Path("second"), goes_on=lambda _: True)
    with pytest.raises(ExecutionError, match="remaining processes of the experiment 'first'"), left:
        pass


@pytest.mark.parametrize(
    "of_another",
    [
        lambda _: "8f4c net:[4026531840]",
        lambda own: own.replace(str(Path("/proc/self/ns/net").readlink()), "net:[1]"),
        lambda _: "",
        lambda _: None,
    ],
    ids=["another", "a container with a network of its own", "unknown", "not told"],
)
def test_what_another_machine_of_a_shared_home_has_claimed_is_its_own(of_another: Callable[[str], str | None]) -> None:
    """Each has a /dev/ttyUSB0. Neither their names nor their ids need differ: cards are copied with /etc/machine-id."""
    first = _holding_under_another_name()
    try:
        path = state_folder("claims").parent / "dhcp-77" / quote("serial:/dev/ttyUSB0", safe="")
        said = json.loads(path.read_text())
        machine = of_another(said.pop("machine"))
        path.write_text(json.dumps(said if machine is None else {**said, "machine": machine}))
        with HeldClaims(["serial:/dev/ttyUSB0"], "second", Path("second")) as held:
            assert held.findings == []
    finally:
        first.kill()
        first.communicate()


def test_where_this_machine_is_not_known_what_has_another_name_is_another_machine_s(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on macOS, where two machines that share a home folder are both unknown."""
    monkeypatch.setattr(claim_locks, "this_boot", str)
    path = state_folder("claims").parent / "dhcp-78" / quote("serial:/dev/ttyUSB7", safe="")
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"experiment": "first", "folder": "first", "pid": 1, "since": "", "machine": ""}))
    with HeldClaims(["serial:/dev/ttyUSB7"], "second", tmp_path, goes_on=Path("first").__eq__) as held:
        assert held.findings == []
