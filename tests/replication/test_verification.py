"""A package that is not as it was packed is refused, and says why; looking at it writes nothing."""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import shutil
import stat
import struct
import zipfile
from pathlib import Path

import pytest
from tests.analysis.experiment_folders import two_tasks
from tests.replication.verified_packages import refusal_of, verified

from robot_runner.core.errors import PackageError
from robot_runner.replication.opening import open_package
from robot_runner.replication.replicating import find_source
from robot_runner.replication.verification import verify_package


def _rezipped(packed, target, change):
    """Write the package anew; `change` gets each name and content and returns both, or None to leave it out."""
    with zipfile.ZipFile(packed.path) as old, zipfile.ZipFile(target, "w") as new:
        for entry in old.infolist():
            changed = change(entry.filename, old.read(entry))
            if changed is not None:
                new.writestr(*changed)
    return target


def _with_sums(unpacked):
    """Make the checksums right again: whoever alters on purpose can do that, too."""
    names = sorted(p.relative_to(unpacked).as_posix() for p in unpacked.rglob("*") if p.is_file())
    lines = [
        f"{hashlib.sha256((unpacked / name).read_bytes()).hexdigest()}  {name}\n"
        for name in names
        if name != "SHA256SUMS"
    ]
    (unpacked / "SHA256SUMS").write_text("".join(lines), encoding="utf-8")


def test_an_intact_package_is_intact_zipped_and_unpacked(packed, unpacked):
    assert verified(packed.path).experiment == "small"
    assert verified(unpacked).file_count == packed.file_count


def test_what_a_desktop_leaves_in_a_folder_that_is_looked_at_is_no_alteration(unpacked):
    (unpacked / ".DS_Store").write_bytes(b"Bud1")
    (unpacked / "runs" / "Thumbs.db").write_bytes(b"Thumbs")
    assert verified(unpacked).is_intact


@pytest.mark.parametrize("share", [0.1, 0.5, 0.999])
def test_a_truncated_package_is_refused(packed, tmp_path, share):
    content = packed.path.read_bytes()
    path = tmp_path / "cut.zip"
    path.write_bytes(content[: int(len(content) * share)])
    assert "end is missing" in refusal_of(path).problem


def test_one_altered_byte_is_found(packed, tmp_path):
    content = bytearray(packed.path.read_bytes())
    with zipfile.ZipFile(packed.path) as archive:
        entry = archive.getinfo("runs/r_1/Ina219/samples.csv")
    content[entry.header_offset + 200] ^= 1
    path = tmp_path / "altered.zip"
    path.write_bytes(content)
    refusal = refusal_of(path)
    assert "runs/r_1/Ina219/samples.csv" in refusal.where
    assert "damaged" in refusal.problem


def test_an_altered_file_is_found_though_the_zip_is_whole(packed, tmp_path):
    path = _rezipped(
        packed,
        tmp_path / "altered.zip",
        lambda name, data: (name, data.replace(b"Done", b"done") if name == "run_table.csv" else data),
    )
    assert "the file was altered" in refusal_of(path).problem


def test_a_missing_file_and_an_added_one_are_found(packed, tmp_path):
    lacking = _rezipped(
        packed, tmp_path / "a.zip", lambda name, data: None if name == "journal.jsonl" else (name, data)
    )
    assert "the file is missing" in refusal_of(lacking).problem
    more = _rezipped(packed, tmp_path / "b.zip", lambda name, data: (name, data))
    with zipfile.ZipFile(more, "a") as archive:
        archive.writestr("config/sitecustomize.py", "print('mine')")
    assert "not part of the package" in refusal_of(more).problem


@pytest.mark.parametrize("name", ["../outside.txt", "config/../../outside.txt", "/outside.txt", "C:/outside.txt"])
def test_names_that_leave_the_folder_are_refused(packed, tmp_path, name):
    path = _rezipped(packed, tmp_path / "evil.zip", lambda each, data: (each, data))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, "mine")
    assert refusal_of(path).problem in {"the file's name leaves the folder", "the file's name is absolute"}
    assert not (tmp_path.parent / "outside.txt").exists()
    assert not Path("/outside.txt").exists()


def test_a_backslash_is_no_way_out(packed, tmp_path):
    path = _rezipped(packed, tmp_path / "evil.zip", lambda each, data: (each, data))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("..\\outside.txt", "mine")
    assert "characters" in refusal_of(path).problem


def test_symbolic_links_are_refused(packed, unpacked, tmp_path):
    path = _rezipped(packed, tmp_path / "evil.zip", lambda each, data: (each, data))
    link = zipfile.ZipInfo("config/link")
    link.create_system = 3
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(link, "/etc/passwd")
    assert "symbolic link" in refusal_of(path).problem
    (unpacked / "config" / "link").symlink_to("/etc/passwd")
    assert "symbolic link" in refusal_of(unpacked).problem


def test_two_files_of_one_name_are_refused(packed, tmp_path):
    path = _rezipped(packed, tmp_path / "evil.zip", lambda each, data: (each, data))
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("run_table.csv", "mine")
    assert "two files" in refusal_of(path).problem


def test_a_zip_bomb_is_refused_without_being_unpacked(packed, tmp_path):
    path = _rezipped(packed, tmp_path / "bomb.zip", lambda each, data: (each, data))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("runs/zeros", "w") as file:
        for _ in range(80):
            file.write(bytes(1 << 20))
    assert "zip bomb" in refusal_of(path).problem


def test_a_file_that_is_larger_than_it_says_is_refused(packed, tmp_path):
    path = _rezipped(packed, tmp_path / "liar.zip", lambda each, data: (each, data))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("runs/long.txt", b"x" * 100_000)
    content = bytearray(path.read_bytes())
    at = content.rfind(b"PK\1\2")  # its entry in the directory: the size is 24 bytes after its beginning
    content[at + 24 : at + 28] = struct.pack("<I", 10)
    path.write_bytes(content)
    with open_package(path) as package, pytest.raises(PackageError, match="damaged"):
        list(package.blocks("runs/long.txt"))
    assert "not part of the package" in refusal_of(path).problem


def test_files_that_share_bytes_are_refused(packed, tmp_path):
    path = _rezipped(packed, tmp_path / "overlap.zip", lambda each, data: (each, data))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("a.txt", "x" * 100)
        archive.writestr("b.txt", "x" * 100)
    content = bytearray(path.read_bytes())
    entries = [content.rfind(b"PK\1\2", 0, end) for end in (len(content), content.rfind(b"PK\1\2"))]
    last, before = entries
    content[last + 42 : last + 46] = content[before + 42 : before + 46]  # where its bytes begin
    path.write_bytes(content)
    assert "shares bytes" in " ".join(finding.problem for finding in refusal_of(path).findings)


def test_a_newer_format_is_refused(unpacked):
    path = unpacked / "package.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), "format": 99}), encoding="utf-8")
    _with_sums(unpacked)
    refusal = refusal_of(unpacked)
    assert "format 99" in refusal.problem
    assert refusal.fix == "Update robot-runner."


def test_a_newer_experiment_is_refused(unpacked):
    path = unpacked / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), "format": 99}), encoding="utf-8")
    _with_sums(unpacked)
    assert "the experiment in it has format 99" in refusal_of(unpacked).problem


def test_a_missing_config_is_refused(unpacked):
    (unpacked / "config" / "small.py").unlink()
    _with_sums(unpacked)
    assert "the config is missing" in refusal_of(unpacked).problem


def test_a_config_outside_the_package_is_refused(unpacked):
    path = unpacked / "manifest.json"
    manifest = json.loads(path.read_text("utf-8"))
    manifest["config"]["file"] = "../../evil.py"
    path.write_text(json.dumps(manifest), encoding="utf-8")
    (unpacked.parent / "evil.py").write_text("raise SystemExit", encoding="utf-8")
    _with_sums(unpacked)
    assert "the config is missing" in refusal_of(unpacked).problem


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("manifest.json", {"config": "small.py"}),
        ("manifest.json", {"executions": [7]}),
        ("manifest.json", {"seed": "7"}),
        ("package.json", {"left_out": {"a": 1}}),
        ("environment/environment.json", {"packages": {"rich": "13"}}),
    ],
)
def test_descriptions_of_a_stranger_are_looked_at_before_they_are_used(unpacked, name, change):
    path = unpacked / name
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), **change}), encoding="utf-8")
    _with_sums(unpacked)
    assert re.search(rf"^{next(iter(change))}\S* is .+, not a ", refusal_of(unpacked).problem)


def test_what_is_no_package_is_refused(tmp_path):
    (tmp_path / "notes.zip").write_text("mine", encoding="utf-8")
    assert "not a zip file" in refusal_of(tmp_path / "notes.zip").problem
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a.txt", "a")
    (tmp_path / "other.zip").write_bytes(buffer.getvalue())
    assert "not a package" in refusal_of(tmp_path / "other.zip").problem
    assert "no such file" in refusal_of(tmp_path / "nowhere.zip").problem
    (tmp_path / "empty").mkdir()
    assert "not a package" in refusal_of(tmp_path / "empty").problem


def test_of_a_folder_the_package_in_it_is_named_and_no_other_archive(packed, tmp_path):
    (tmp_path / "lab").mkdir()
    with zipfile.ZipFile(tmp_path / "lab" / "holiday.zip", "w") as archive:
        archive.writestr("beach.txt", "")
    assert refusal_of(tmp_path / "lab").fix.startswith("Name a package;")
    shutil.copy(packed.path, tmp_path / "lab" / "z_study.zip")
    assert refusal_of(tmp_path / "lab").fix == f"Name what lies in it: {tmp_path / 'lab' / 'z_study.zip'}"


def test_faults_do_not_grow_without_end(unpacked):
    for place in range(50):
        (unpacked / f"more_{place}.txt").write_text("mine", encoding="utf-8")
    findings = refusal_of(unpacked).findings
    assert len(findings) == 21
    assert "more faults" in findings[-1].problem


def test_unpacking_writes_below_the_folder_alone(packed, tmp_path):
    source = find_source(packed.path, lambda _, __: None)
    root = source.unpacked_below(tmp_path / "target", lambda _, __: None)
    assert [path.name for path in tmp_path.iterdir()] == ["target"]
    assert [path.name for path in (tmp_path / "target").iterdir()] == ["package"]
    assert verified(root).is_intact


def test_what_was_altered_after_it_was_unpacked_is_noticed(packed, tmp_path):
    source = find_source(packed.path, lambda _, __: None)
    root = source.unpacked_below(tmp_path, lambda _, __: None)
    (root / "config" / "small.py").write_text("raise SystemExit", encoding="utf-8")
    with pytest.raises(PackageError, match="altered"):
        source.unpacked_below(tmp_path, lambda _, __: None)


def test_another_package_is_not_mixed_with_the_one_that_is_there(packed, tmp_path):
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "SHA256SUMS").write_text("", encoding="utf-8")
    with pytest.raises(PackageError, match="another package"):
        find_source(packed.path, lambda _, __: None).unpacked_below(tmp_path, lambda _, __: None)


def test_a_replication_is_not_written_into_its_original(unpacked):
    with pytest.raises(PackageError, match="into its original"):
        find_source(unpacked, lambda _, __: None).refuse_target(unpacked / "again")


@pytest.mark.parametrize(
    ("name", "key", "value", "fault"),
    [
        ("package.json", "left_out", None, "left_out is None, not a list"),
        ("package.json", "replaced", None, "replaced is None, not a list"),
        (
            "environment/environment.json",
            "packages",
            {"numpy": {"is_needed": True}},
            "packages.numpy.version is missing",
        ),
        ("environment/environment.json", "packages", {"numpy": {"version": "1", "fingerprint": []}}, "fingerprint is"),
        ("environment/environment.json", "host", {"memory_bytes": "much"}, "host.memory_bytes is 'much'"),
        ("environment/environment.json", "ros", {"distro": "jazzy"}, "ros.version is missing"),
        ("environment/environment.json", "ros", {"version": 2, "packages": {"nav2": 1}}, "ros.packages.nav2 is 1"),
    ],
)
def test_what_is_compared_with_this_machine_is_refused_unless_it_is_as_it_has_to_be(unpacked, name, key, value, fault):
    facts = json.loads((unpacked / name).read_text(encoding="utf-8"))
    (unpacked / name).write_text(json.dumps({**facts, key: value}), encoding="utf-8")
    _with_sums(unpacked)
    assert fault in refusal_of(unpacked).problem


def test_so_is_that_of_a_folder_that_nobody_sealed(tmp_path):
    folder = two_tasks(tmp_path / "made", (1.0,), (3.0,), manifest={"ros": {"distro": "jazzy"}}).root
    with pytest.raises(PackageError, match=re.escape("ros.version is missing")):
        find_source(folder, lambda _, __: None)


def test_a_folder_that_is_no_package_is_said_to_be_none_though_files_of_it_go_meanwhile(tmp_path, monkeypatch):
    (tmp_path / "run_table.csv").write_text("run_id\n")

    def walk(root):
        yield str(root), [], ["run_table.csv", ".run_table.csv.1.tmp"]  # which was renamed since it was listed

    monkeypatch.setattr(os, "walk", walk)
    with open_package(tmp_path) as package:
        assert list(package.sizes) == ["run_table.csv"]
        with pytest.raises(PackageError, match="this is not a package"):
            verify_package(package)
