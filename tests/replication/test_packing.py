"""A package holds everything that others need, nothing that is private, and is the same each time."""

from __future__ import annotations

import gzip
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tracemalloc
import zipfile
from pathlib import Path

import pytest
from tests.analysis.experiment_folders import two_tasks
from tests.analysis.importing.foreign_folder import make_earlier_folder
from tests.linked_environment import is_locked_environment
from tests.replication.small_experiment import CHANGING, RUNS, SECRET, home, own_modules

from robot_runner.analysis.importing.adoption import adopt
from robot_runner.analysis.importing.description import ImportDescription
from robot_runner.analysis.importing.understanding import understand
from robot_runner.core.config.authors import Author
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import PackageError
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.lock import ExperimentLock
from robot_runner.replication.about import About, readme
from robot_runner.replication.contents import Contents, choose_contents, fault_of_name
from robot_runner.replication.opening import open_package
from robot_runner.replication.packing import pack
from robot_runner.replication.sealing import Packing

#: Other versions than the lock's are tried as well (`make lower-bounds`): of these it knows no hash.
of_the_lock = pytest.mark.skipif(
    not is_locked_environment(Path(__file__).parents[2] / "requirements" / "test.txt"),
    reason="the installed versions are not those of the lock",
)


@pytest.fixture
def copied(experiment, tmp_path):
    return Path(shutil.copytree(experiment, tmp_path / "small"))


def _pack(folder, target, **asked):
    """Pack without the wheels of this tree, which take longer than everything else."""
    return pack(folder, target, Packing(with_wheels=False, **asked))


def _names(path):
    with zipfile.ZipFile(path) as archive:
        return set(archive.namelist())


def _text(path, name):
    with zipfile.ZipFile(path) as archive:
        return archive.read(name).decode()


@pytest.mark.long
def test_a_line_that_was_printed_two_million_times_is_taken_for_no_bomb_by_who_receives_it(copied, ada, tmp_path):
    run = next((copied / "runs").iterdir())
    (run / "printed.log").write_bytes(b"no transform from map to base_link\n" * (2 << 20))
    with home(ada):
        packed = _pack(copied, tmp_path / "small.zip")
    with open_package(packed.path) as package:
        assert package.sizes[f"runs/{run.name}/printed.log"] == 70 << 20
        assert not package.faults


@pytest.mark.long
def test_packing_twice_gives_the_same_bytes(experiment, ada, tmp_path):
    # Wheels of code that somebody edits meanwhile would differ: that they are the same is a test of theirs.
    with home(ada):
        first, again = (pack(experiment, tmp_path / name, Packing(with_wheels=False)) for name in ("a.zip", "b.zip"))
    assert again.sha256 == first.sha256
    assert again.path.read_bytes() == first.path.read_bytes()


def test_everything_that_others_need_is_in_it(packed):
    names = _names(packed.path)
    assert names >= {
        "config/small.py",
        "config/packed_paces.py",
        "run_table.csv",
        "run_table.schema.json",
        "journal.jsonl",
        "manifest.json",
        "runs/r_1/log.txt",
        "runs/r_1/Ina219/samples.csv",
        "environment/requirements.txt",
        "environment/environment.json",
        "ro-crate-metadata.json",
        "datapackage.json",
        "package.json",
        "SHA256SUMS",
        "README.md",
        "Containerfile",
        "LICENSE",
        "CITATION.cff",
        ".zenodo.json",
        "BADGES.md",
    }
    assert {name for name in names if "current_log" in name or name.startswith(".")} == {".zenodo.json"}


def test_the_checksums_can_be_checked_without_us(unpacked):
    checked = subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=unpacked, check=False)
    assert checked.returncode == 0


def test_secrets_and_home_paths_are_nowhere(packed, ada):
    with zipfile.ZipFile(packed.path) as archive:
        for name in archive.namelist():
            content = archive.read(name)
            assert SECRET.encode() not in content, name
            assert str(ada).encode() not in content, name
            if not name.endswith(".whl"):  # our own documentation has examples
                assert b"/home/ada" not in content, name


@pytest.mark.long
def test_a_secret_of_the_environment_is_replaced_as_text_json_and_tables_write_it(copied, tmp_path, monkeypatch):
    planted = 'open-"sesame'
    monkeypatch.setenv("LAB_TOKEN", planted)
    forms = (planted, json.dumps(planted)[1:-1], planted.replace('"', '""'))
    raw = copied / "runs" / "r_1" / "said"
    raw.mkdir(parents=True)
    for ending, text in zip(("txt", "json", "csv"), forms, strict=True):
        (raw / f"said.{ending}").write_text(f'a,"{text}"\n' if ending == "csv" else f'["{text}"]\n', encoding="utf-8")
    package = _pack(copied, tmp_path / "package.zip").path
    for ending in ("txt", "json", "csv"):
        text = _text(package, f"runs/r_1/said/said.{ending}")
        assert "sesame" not in text
        assert "REDACTED" in text


def test_what_was_replaced_is_listed(packed):
    listed = {(each.name, each.what): each.count for each in packed.replaced}
    assert listed["config/small.py", "password"] == 1
    assert listed["config/small.py", "home path"] == 1
    assert listed["runs/r_1/log.txt", "password"] == 1
    assert listed["runs/r_1/log.txt", "home path"] == 1
    assert ("manifest.json", "password") not in listed  # Debian's packages passwd and base-passwd
    assert json.loads(_text(packed.path, "package.json"))["replaced"] == [
        {"name": each.name, "what": each.what, "count": each.count, "lines": list(each.lines)}
        for each in packed.replaced
    ]


def test_a_config_still_parses_once_its_secrets_are_replaced(packed):
    code = _text(packed.path, "config/small.py")
    compile(code, "small.py", "exec")
    assert 'wifi_password = "REDACTED"' in code


@pytest.mark.long
def test_keys_links_and_what_is_half_written_stay_behind(copied, tmp_path):
    (copied / "known_hosts").write_text("robot ssh-ed25519 AAAA\n", encoding="utf-8")
    (copied / "robot.pem").write_text("-----BEGIN PRIVATE KEY-----", encoding="utf-8")
    (copied / "passwords").symlink_to("/etc/passwd")
    (copied / "elsewhere").symlink_to("/etc", target_is_directory=True)
    # The copy of a repository that was being made when the execution was killed.
    (copied / "revisions/.planner-1a2b3c4d.git.tmp").mkdir(parents=True)
    (copied / "revisions/.planner-1a2b3c4d.git.tmp/HEAD").touch()
    (copied / ".config.tmp").mkdir()  # likewise that of a config
    (copied / ".config.tmp/study.py").touch()
    packed = _pack(copied, tmp_path / "small.zip")
    assert {each.name for each in packed.left_out} == {"known_hosts", "robot.pem", "passwords", "elsewhere"}
    assert not {"known_hosts", "robot.pem", "passwords"} & _names(packed.path)
    assert not any("revisions" in name or ".tmp" in name for name in _names(packed.path))
    assert "`robot.pem`" in _text(packed.path, "README.md")


def test_what_only_an_execution_needs_is_not_packed(tmp_path):
    folder = two_tasks(tmp_path / "made", (1.0,), (3.0,))
    before = [each.name for each in choose_contents(folder.files, ["r_1", "r_2"]).files]
    mark = ".probe-0123456789abcdef"
    for name in (".lock", ".alive_2", ".pause", ".stop", mark, f"{mark}-fedcba9876543210"):
        (folder.root / name).touch()
    (folder.root / ".aside-x3kd81_q" / "runs").mkdir(parents=True)  # of a gate that was killed
    (folder.root / ".aside-x3kd81_q" / ".alive").touch()
    chosen = choose_contents(folder.files, ["r_1", "r_2"])
    assert ([each.name for each in chosen.files], chosen.left_out) == (before, ())


def test_raw_data_are_packed_or_listed_whatever_their_names(tmp_path):
    folder = two_tasks(tmp_path / "made", (1.0,), (3.0,))
    run = folder.files.run("r_1")
    for name in (
        "Bag/scan.tmp",
        "Bag/scan~",
        "Bag/trace.pyc",
        "Bag/.git/config",
        "Bag/__pycache__/a.pyc",
        "Bag/.x.7.tmp",
    ):
        (run / name).parent.mkdir(parents=True, exist_ok=True)
        (run / name).write_bytes(b"raw")
    chosen = choose_contents(folder.files, ["r_1", "r_2"])
    below = f"{run.relative_to(folder.root).as_posix()}/Bag"
    assert {each.name for each in chosen.files if "Bag" in each.name} == {
        f"{below}/scan.tmp",
        f"{below}/scan~",
        f"{below}/trace.pyc",
    }
    assert [each.name for each in chosen.left_out] == [f"{below}/.git"]


@pytest.mark.long
def test_a_file_whose_name_is_no_text_stays_behind_and_is_told(copied, tmp_path):
    Path(os.fsdecode(os.fsencode(copied) + b"/runs/r_1/caf\xe9.txt")).write_text("from another system\n")
    cut_off = gzip.compress(b"x")[:-4]
    with tarfile.open(copied / "runs" / "r_1" / "old.tar", "w") as archive:
        member = tarfile.TarInfo(os.fsdecode(b"caf\xe9.gz"))
        member.size = len(cut_off)
        archive.addfile(member, io.BytesIO(cut_off))
    packed = _pack(copied, tmp_path / "small.zip")
    assert [each.name for each in packed.left_out] == [r"runs/r_1/caf\udce9.txt"]
    assert [r"caf\udce9" in each.why for each in packed.not_searched] == [True]
    assert json.loads(_text(packed.path, "package.json"))["left_out"][0]["name"] == packed.left_out[0].name


@pytest.mark.long
def test_results_that_were_imported_are_not_said_to_be_executed_with_robot_runner(tmp_path):
    earlier = make_earlier_folder(tmp_path / "earlier")
    adopt(understand(earlier, ImportDescription()), tmp_path / "ours")
    packed = _pack(tmp_path / "ours", tmp_path / "ours.zip")
    for name in ("README.md", ".zenodo.json", "CITATION.cff", "ro-crate-metadata.json", "datapackage.json"):
        assert "executed with Robot Runner" not in _text(packed.path, name), name
        assert "Robot Runner executed" not in _text(packed.path, name), name
    told = _text(packed.path, "README.md")
    assert "imported into Robot Runner" in told
    assert "nobody can execute it again" in told
    assert "robot-runner replicate" not in told
    (undone,) = [each for each in packed.findings if "are not done" in each.problem]
    assert undone.fix == "Say why where you publish it."
    crate = json.loads(_text(packed.path, "ro-crate-metadata.json"))["@graph"]
    (action,) = (each for each in crate if each["@type"] == "CreateAction")
    assert action["name"] == "Import of earlier"
    assert action["actionStatus"].endswith("CompletedActionStatus")


@pytest.mark.long
def test_runs_that_the_table_had_as_done_are_no_actions_by_the_config(tmp_path):
    config, folder = tmp_path / "changing.py", tmp_path / "results" / "changing"
    config.write_text(CHANGING, encoding="utf-8")
    folder.mkdir(parents=True)
    (folder / "run_table.csv").write_text("run_id,status,Task,Score\nold,Done,Video,7.5\nnew,-,Network,\n", "utf-8")
    with own_modules():
        execute_experiment(prepare_or_refuse(config), SilentObserver())
    crate = json.loads(_text(_pack(folder, tmp_path / "ours.zip").path, "ro-crate-metadata.json"))["@graph"]
    actions = {each["name"] for each in crate if each["@type"] == "CreateAction"}
    assert actions == {"Execution of changing", "Run new"}


@pytest.mark.long
def test_files_in_whose_place_the_package_has_its_own_are_told(copied, tmp_path, unpacked):
    (copied / "README.md").write_text("The door was open on Monday.\n", encoding="utf-8")
    packed = _pack(copied, tmp_path / "small.zip")
    assert [each.name for each in packed.left_out] == ["README.md"]
    assert _pack(unpacked, tmp_path / "again.zip").left_out == (), "they are of the package before"


@pytest.mark.long
def test_a_binary_file_with_a_secret_is_left_out_unless_it_is_kept(copied, tmp_path):
    (copied / "recording.db3").write_bytes(b"\0\1\2 /home/ada/bags \0")
    assert [each.name for each in _pack(copied, tmp_path / "a.zip").left_out] == ["recording.db3"]
    kept = _pack(copied, tmp_path / "b.zip", keep=("*.db3",))
    assert kept.left_out == ()
    assert "recording.db3" in _names(kept.path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("raw", "taken"),
    [(("none",), set()), (("PsUtil",), {"PsUtil"}), (("all",), {"PsUtil", "Ina219", "BasicTurtlebot3"})],
)
def test_raw_data_can_be_chosen(copied, tmp_path, raw, taken):
    packed = _pack(copied, tmp_path / "small.zip", raw=raw)
    names = {name for name in _names(packed.path) if name.startswith("runs/")}
    assert {name.split("/")[2] for name in names if name.count("/") == 3} == taken
    assert "runs/r_1/log.txt" in names
    assert len(packed.left_out) == 3 - len(taken)


@pytest.mark.long
def test_raw_data_of_a_plugin_that_has_none_are_refused(copied, tmp_path):
    with pytest.raises(PackageError, match="'Ina219'"):
        pack(copied, tmp_path / "small.zip", Packing(raw=("Ina129",)))
    assert not (tmp_path / "small.zip").exists()


@pytest.mark.long
def test_who_packs_may_name_authors_and_licence(copied, tmp_path):
    packed = _pack(copied, tmp_path / "small.zip", authors=(Author("Ada Lovelace"),), licence="MIT")
    crate = json.loads(_text(packed.path, "ro-crate-metadata.json"))["@graph"]
    root = next(entity for entity in crate if entity["@id"] == "./")
    assert root["license"] == {"@id": "https://spdx.org/licenses/MIT"}
    assert [entity["name"] for entity in crate if entity["@type"] == "Person"] == ["Ada Lovelace"]
    assert "has no orcid" in " ".join(finding.problem for finding in packed.findings)


@of_the_lock
def test_the_environment_names_versions_and_fingerprints(packed):
    environment = json.loads(_text(packed.path, "environment/environment.json"))
    rich = environment["packages"]["rich"]
    assert rich["is_needed"]
    assert len(rich["fingerprint"]) == 64
    lines = _text(packed.path, "environment/requirements.txt").splitlines()
    assert any(line.startswith(f"rich=={rich['version']} ") and "--hash=sha256:" in line for line in lines)
    assert not [line for line in lines if line.startswith("pytest")]
    assert environment["host"]["memory_bytes"] > 0


@pytest.mark.long
def test_an_experiment_that_is_being_executed_is_not_packed(copied, tmp_path):
    with ExperimentLock(copied / ".lock"):  # this process holds it: another one has to look
        code = (
            "from pathlib import Path; from robot_runner.replication.packing import pack; pack(Path({!r}), Path({!r}))"
        )
        words = code.format(str(copied), str(tmp_path / "a.zip"))
        asked = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=False)
    assert "is being executed by process" in asked.stderr
    assert not (tmp_path / "a.zip").exists()


def test_a_package_is_not_written_into_what_it_holds(copied):
    with pytest.raises(PackageError, match="part of what it holds"):
        pack(copied, copied / "small.zip")


def test_a_file_that_is_no_package_is_not_replaced(copied, tmp_path):
    (tmp_path / "notes.zip").write_text("mine", encoding="utf-8")
    with pytest.raises(PackageError, match="is not a package"):
        pack(copied, tmp_path / "notes.zip")
    assert (tmp_path / "notes.zip").read_text(encoding="utf-8") == "mine"


def test_a_pipe_is_refused_without_waiting_for_somebody_at_its_other_end(copied, tmp_path):
    os.mkfifo(tmp_path / "pipe.zip")
    words = [sys.executable, "-m", "robot_runner", "pack", str(copied), "--to", str(tmp_path / "pipe.zip")]
    refused = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    assert refused.returncode == 2
    assert "a file of this name exists, and is not a package" in refused.stderr


def test_a_folder_is_not_taken_for_a_file_to_be_removed(copied, tmp_path):
    (tmp_path / "packages").mkdir()
    with pytest.raises(PackageError, match="is a folder") as refused:
        _pack(copied, tmp_path / "packages")
    assert refused.value.fix == f"Name a file in it: {tmp_path / 'packages' / 'small.zip'}"


@pytest.mark.long
def test_more_files_than_a_reader_takes_are_refused_before_any_is_packed(copied, tmp_path, monkeypatch):
    target = tmp_path / "small.zip"
    room = 1 << 16  # for what packing itself adds to the directory
    for number in range(1000):
        (copied / "runs" / "r_1" / "Ina219" / f"{number:0100d}.csv").write_text("time_s\n", encoding="utf-8")
    needed = 1000 * (46 + len("runs/r_1/Ina219/") + 104)
    for module in ("packing", "opening"):
        monkeypatch.setattr(f"robot_runner.replication.{module}.LARGEST_DIRECTORY", needed)
    with pytest.raises(PackageError, match=r"would have 1,0\d\d files and folders, more than verify") as refused:
        _pack(copied, target)
    assert "--raw none" in refused.value.fix
    assert not target.exists()
    for module in ("packing", "opening"):
        monkeypatch.setattr(f"robot_runner.replication.{module}.LARGEST_DIRECTORY", needed + room + 8192)
    _pack(copied, target)
    with open_package(target) as package:
        assert sum("Ina219/0" in name for name in package.sizes) == 1000


@pytest.mark.long
def test_sizes_are_added_up_once_whatever_the_number_of_files(copied, tmp_path, monkeypatch):
    looks = []

    class Counted(tuple):
        __slots__ = ()

        def __iter__(self):
            looks.append(1)
            return super().__iter__()

    def choose(*given):
        chosen = choose_contents(*given)
        return Contents(Counted(chosen.files), chosen.left_out)

    monkeypatch.setattr("robot_runner.replication.packing.choose_contents", choose)
    _pack(copied, tmp_path / "small.zip")
    few = len(looks)
    looks.clear()
    for number in range(50):
        (copied / "runs" / "r_1" / "Ina219" / f"{number}.csv").write_text("time_s\n", encoding="utf-8")
    _pack(copied, tmp_path / "small.zip")
    assert len(looks) == few


@pytest.mark.long
def test_memory_does_not_grow_with_the_size_of_a_file(copied, tmp_path):
    line = b"0.041389,6051,24938,0.605100,12.468,7.544387\n"
    with (copied / "runs" / "r_1" / "Ina219" / "long.csv").open("wb") as file:
        for _ in range(40):
            file.write(line * ((1 << 20) // len(line)))
    (copied / "runs" / "r_1" / "Ina219" / "one_line.csv").write_bytes(b"7" * (10 << 20))
    told = []
    tracemalloc.start()
    try:
        pack(copied, tmp_path / "a.zip", Packing(with_wheels=False), lambda done, total: told.append((done, total)))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 32 << 20
    assert told[-1][0] == told[-1][1] > 50 << 20


@pytest.mark.long
def test_what_is_missing_is_said(copied, tmp_path):
    said = " ".join(finding.problem for finding in _pack(copied, tmp_path / "small.zip").findings)
    assert "there is no report" in said
    shutil.rmtree(copied / "config")
    said = " ".join(finding.problem for finding in _pack(copied, tmp_path / "small.zip").findings)
    assert "there is no config" in said


def test_the_table_of_the_package_has_every_run(packed):
    assert len(_text(packed.path, "run_table.csv").splitlines()) == RUNS + 1


@pytest.mark.parametrize("name", ["\u00e9" * 121, "\U0001f916" * 61, "/".join(["\u20ac" * 70] * 20)])
def test_a_name_that_no_disk_takes_is_no_name_of_a_package(name):
    assert fault_of_name(name) == "the file's name is longer, or in more folders, than a disk takes"
    assert fault_of_name(name[: len(name) // 3]) is None


def test_the_inventory_names_what_else_stood_in_the_folder_and_the_runs_of_an_earlier_tool() -> None:
    names = ["run_table.csv", "config/a.py", "earlier_configs/1/a.py", "earlier_attempts/r_1/1/log.txt", "notes.txt"]
    about = About("naps", (), None, None, "2026-01-31T12:00:00Z")
    text = readme(about, {}, [*names, *(f"run_{place}/log.txt" for place in range(9))], ())
    assert "| `earlier_configs/` | the config as it was executed before it was changed, numbered in order |\n" in text
    assert "| `earlier_attempts/` | the raw data and the log of attempts that were executed again |\n" in text
    assert "| `notes.txt`, `run_0/`, `run_1/`, `run_2/` and 6 more | runs of an earlier tool" in text
