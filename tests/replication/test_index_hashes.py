"""The package index that pip is set up for is asked for hashes; nothing fails where it has none."""

from __future__ import annotations

import json
import re
import socket
import sys
import zipfile
from pathlib import Path

import pytest
from tests.linked_environment import is_locked_environment
from tests.loopback_port import claim_port
from tests.replication.small_experiment import home
from tests.replication.small_index import SmallIndex, pip_settings, tiny_wheel

from robot_runner.core.errors import PackageError
from robot_runner.replication import index_hashes
from robot_runner.replication.distributions import canonical
from robot_runner.replication.environment import record_environment
from robot_runner.replication.index_hashes import ask_index, findings_of_hashes
from robot_runner.replication.packing import pack
from robot_runner.replication.sealing import Packing
from robot_runner.replication.virtual_environments import make_environment

PYTHON = "3.11.7"
#: Other versions than the lock's are tried as well (`make lower-bounds`): of these it knows no hash.
of_the_lock = pytest.mark.skipif(
    not is_locked_environment(Path(__file__).parents[2] / "requirements" / "test.txt"),
    reason="the installed versions are not those of the lock",
)


@pytest.fixture
def set_up_pip(monkeypatch):
    def set_up(address):
        for name, text in pip_settings(address).items():
            monkeypatch.delenv(name, raising=False) if text is None else monkeypatch.setenv(name, text)

    return set_up


@pytest.fixture
def index(tmp_path, set_up_pip):
    small = SmallIndex(tmp_path / "index")
    with small.served() as address:
        set_up_pip(address)
        yield small


@pytest.mark.long
def test_the_hash_is_that_of_exactly_the_recorded_version(index):
    digest = index.add("tiny", "1.0")
    index.add("tiny", "2.0")
    answer = ask_index(["tiny==1.0"], PYTHON)
    assert answer.hashes == {"tiny": (digest,)}
    assert answer.lacking == {}


@pytest.mark.long
def test_files_of_the_other_platforms_have_their_hashes_beside_it(index):
    platforms = ("manylinux2014_x86_64", "manylinux_2_28_aarch64", "macosx_11_0_arm64")
    digests = {index.add("fast", platform=platform) for platform in platforms}
    index.add("fast", platform="win_amd64")
    assert set(ask_index(["fast==1.0"], PYTHON).hashes["fast"]) == digests


@pytest.mark.long
def test_what_is_not_in_the_index_is_lacking_and_the_others_are_not(index):
    digests = {name: (index.add(name),) for name in ("a", "b", "d", "e")}
    answer = ask_index(["e==1.0", "d==1.0", "c==1.0", "b==1.0", "a==1.0"], PYTHON)
    assert answer.hashes == digests
    assert answer.lacking == {"c": "pip finds no wheel of that version"}


def test_the_lock_knows_exactly_its_versions(tmp_path):
    digests = ["ab" * 32, "cd" * 32]
    lines = ["Tiny_one==1.0 ; python_version >= '3.11' \\", f"    --hash=sha256:{digests[1]} \\"]
    lines += [f"    --hash=sha256:{digests[0]}"]
    lines += ["    # via other", f"other==2.0 \\\n    --hash=sha256:{'ef' * 32}", "bare==3.0", ""]
    (tmp_path / "lock.txt").write_text("\n".join(lines), encoding="utf-8")
    pins = ["tiny-one==1.0", "other==2.1", "bare==3.0"]
    assert index_hashes.locked_hashes(pins, tmp_path) == {"tiny-one": tuple(digests)}


@pytest.mark.long
@of_the_lock
def test_the_lock_of_the_project_saves_asking_the_index(experiment):
    manifest = json.loads((experiment / "manifest.json").read_text("utf-8"))
    recorded = record_environment(manifest, experiment / "config")
    known, lacking = index_hashes.with_known_hashes(recorded)
    assert len(known.without_hash({})) < len(recorded.without_hash({})) / 4
    assert lacking == {}


@pytest.mark.long
def test_nobody_answers_where_there_is_no_index(set_up_pip):
    set_up_pip(f"http://127.0.0.1:{claim_port()}/")
    answer = ask_index([f"{name}==1.0" for name in "abcde"], PYTHON)
    assert answer.hashes == {}
    assert set(answer.lacking.values()) == {"no package index answers, or it has none of them"}


@pytest.mark.long
def test_an_index_that_is_silent_is_not_waited_for(set_up_pip):
    with socket.create_server(("127.0.0.1", 0)) as silent:
        set_up_pip(f"http://127.0.0.1:{silent.getsockname()[1]}/")
        answer = ask_index(["tiny==1.0"], PYTHON, deadline_s=2.0)
    assert answer.lacking == {"tiny": "there was no answer within 2 s"}


@pytest.mark.long
def test_files_of_a_folder_of_ones_own_do_not_count(index, tmp_path, monkeypatch):
    digest = index.add("tiny")
    assert tiny_wheel(tmp_path / "own", "tiny", code="changed = True\n") != digest
    tiny_wheel(tmp_path / "own", "mine")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "own"))
    answer = ask_index(["tiny==1.0", "mine==1.0"], PYTHON)
    assert answer.hashes == {"tiny": (digest,)}
    assert answer.lacking == {"mine": "pip takes it from a folder of this machine, which others do not have"}


def test_one_finding_for_each_reason_names_the_packages(tmp_path):
    packages = {"robot_runner": "0.0.1", "rich": "1.0", "left_pad": "1.0"}
    environment = record_environment({"software": {"packages": packages}}, tmp_path)
    lacking = {"rich": "why", "left-pad": "why", "robot-runner": "why not"}
    found = [each.problem for each in findings_of_hashes(environment.without_hash({}), lacking)]
    assert found == ["no hash of 2 of the packages needed: left-pad, rich: why", "no hash of robot-runner: why not"]


@pytest.mark.long
def test_the_requirements_demand_the_hash_of_every_package_and_are_the_same_each_time(
    experiment, ada, index, tmp_path, monkeypatch
):
    manifest = json.loads((experiment / "manifest.json").read_text("utf-8"))
    recorded = record_environment(manifest, experiment / "config")
    for each in recorded.needed:
        index.add(each.name, each.version)
    # The index is asked for a few of them: it is pip that takes its time for each.
    monkeypatch.setattr(
        index_hashes,
        "locked_hashes",
        lambda pins: {canonical(pin.partition("==")[0]): ("0" * 64,) for pin in sorted(pins)[8:]},
    )
    with home(ada):
        first = pack(experiment, tmp_path / "a.zip", Packing(with_hashes=True))
    again, _ = index_hashes.with_known_hashes(recorded, lambda _: None)
    pinned, pinned_again = _pinned(first), again.requirements(dict.fromkeys(first.wheels, "0" * 64)).splitlines()
    assert len(pinned) == first.package_count > 50
    assert all(re.fullmatch(r"\S+==\S+( --hash=sha256:[0-9a-f]{64})+", line) for line in pinned), pinned
    assert first.without_hash == ()
    # Wheels of code that somebody edits meanwhile differ: that they are the same is a test of theirs.
    of_index = {line for line in pinned if line.partition("==")[0] not in first.wheels}
    again_of_index = {line for line in pinned_again if line.partition("==")[0] not in first.wheels}
    assert of_index == {line for line in again_of_index if not line.startswith("#")}
    with zipfile.ZipFile(first.path) as archive:
        made = (name for name in archive.namelist() if name.startswith("environment/") and not name.endswith(".whl"))
        assert not [name for name in made if b"127.0.0.1" in archive.read(name)]


@pytest.mark.long
def test_a_file_of_another_hash_is_not_installed(tmp_path, index):
    root = tmp_path / "package"
    (root / "environment").mkdir(parents=True)
    index.add("tiny")
    line = f"tiny==1.0 --hash=sha256:{'ab' * 32}\n"
    (root / "environment" / "requirements.txt").write_text(line, encoding="utf-8")
    with pytest.raises(PackageError, match="the environment cannot be made") as refused:
        make_environment(root, tmp_path / "made", {})
    assert refused.value.findings[0].problem.startswith("the environment cannot be made: ERROR: ")  # no progress of pip
    assert "sha256" in refused.value.findings[0].problem
    assert "say for which Python" in refused.value.findings[0].fix
    with pytest.raises(PackageError) as refused:  # of that Python there are other files
        make_environment(root, tmp_path / "made", {"python": "3.99.1"})
    here = f"{sys.version_info.major}.{sys.version_info.minor}"
    told = f"hashes are of files for Python 3.99, and this is Python {here}: install that one, so that python3.99 is"
    assert refused.value.findings[0].fix.startswith("Correct what is said there")  # it may be the index that is missing
    assert told in refused.value.findings[0].fix
    assert not list(tmp_path.glob("made/lib/python*/site-packages/tiny.py"))


def test_what_a_compiler_said_is_shown_where_a_package_cannot_be_built(tmp_path, monkeypatch):
    said = (
        "Collecting slow",
        "  error: subprocess-exited-with-error",
        "      fatal error: Python.h: No such file",
        "  ERROR: Failed building wheel for slow",
        "ERROR: Failed to build installable wheels",
    )
    python = tmp_path / "python"
    python.write_text("\n".join(["#!/bin/sh", *(f"echo '{line}'" for line in said), "exit 1"]), encoding="utf-8")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    (tmp_path / "environment").mkdir()
    (tmp_path / "environment" / "requirements.txt").write_text("slow==1.0\n", encoding="utf-8")
    own = f"{sys.version_info.major}.{sys.version_info.minor}.0"
    with pytest.raises(PackageError, match=r"cannot be made: error: .*Python\.h.*installable wheels"):
        make_environment(tmp_path, tmp_path / "made", {"python": own})


@pytest.mark.long
def test_a_list_with_hashes_is_installed_also_once_newer_releases_are_there(tmp_path, index):
    old = index.add("library", "1.0")
    index.add("library", "2.0")
    application = index.add("application", needs="library[more]>=1.0")
    root = tmp_path / "package"
    (root / "environment").mkdir(parents=True)
    lines = f"application==1.0 --hash=sha256:{application}\nlibrary==1.0 --hash=sha256:{old}\n"
    (root / "environment" / "requirements.txt").write_text(lines, encoding="utf-8")
    make_environment(root, tmp_path / "made", {})
    names = [path.name for path in tmp_path.glob("made/lib/python*/site-packages/*.dist-info")]
    assert sorted(names) == ["application-1.0.dist-info", "library-1.0.dist-info"]


def _pinned(packed):
    with zipfile.ZipFile(packed.path) as archive:
        lines = archive.read("environment/requirements.txt").decode().splitlines()
    return [line for line in lines if not line.startswith("#")]


@pytest.mark.parametrize("info", [{}, {"hashes": {"md5": "ab"}}])
def test_a_file_of_which_an_index_tells_no_sha_256_is_of_no_use_to_others(info):
    file = index_hashes._File.of_download({"url": "https://example.org/a-1-py3-none-any.whl", "archive_info": info})
    assert file.sha256 == ""
    assert "SHA-256" in file.fault
