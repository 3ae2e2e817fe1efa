"""Of the kinds of secrets that labs have, hardly one gets into a package, and what is packed still works."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
import zipfile
from dataclasses import asdict
from pathlib import Path

import pytest
import yaml
from tests.replication.planted_secrets import CONFIG, plant

from robot_runner.replication.opening import open_package
from robot_runner.replication.packing import pack
from robot_runner.replication.sealing import Packing
from robot_runner.replication.verification import verify_package


@pytest.fixture(scope="module")
def secret_study(experiment, tmp_path_factory):
    folder = Path(shutil.copytree(experiment, tmp_path_factory.mktemp("planted") / "small"))
    return folder, plant(folder)


@pytest.fixture(scope="module")
def packed_secrets(secret_study, tmp_path_factory):
    folder, planted = secret_study
    packed = pack(folder, tmp_path_factory.mktemp("out") / "small.zip", Packing(with_wheels=False, doubtful="replace"))
    return packed, planted


def _contents(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _leaked(planted, contents):
    forms = {
        each.kind: [each.marker.encode(coding) for coding in ("utf-8", "utf-16-le", "utf-16-be")] for each in planted
    }
    return [kind for kind, texts in forms.items() if any(text in raw for text in texts for raw in contents.values())]


@pytest.mark.long
def test_hardly_a_secret_is_in_the_package(packed_secrets, record_property):
    packed, planted = packed_secrets
    assert len({each.kind for each in planted}) == len({each.marker for each in planted}) == len(planted) >= 63
    leaked = _leaked(planted, _contents(packed.path))
    record_property(
        "figure", f"secrets: {len(planted) - len(leaked)} of {len(planted)} planted kinds are not in the package"
    )
    assert len(leaked) <= len(planted) // 21, leaked  # 60 of 63


def test_what_is_packed_can_still_be_read(packed_secrets):
    packed, _ = packed_secrets
    contents = _contents(packed.path)
    for name, raw in contents.items():
        if name.endswith(".py"):
            compile(raw, name, "exec")
        elif name.endswith((".json", ".ipynb")):
            json.loads(raw)
        elif name.endswith(".jsonl"):
            assert all(json.loads(line) for line in raw.splitlines())
    yaml.safe_load(contents["config/lab.yaml"])
    tomllib.loads(contents["config/lab.toml"].decode())
    assert "Ende" in contents["runs/r_1/windows.txt"].decode("utf-16")
    with open_package(packed.path) as package:
        assert not [each for each in verify_package(package).findings if each.is_error]


def test_what_was_replaced_is_told_by_file_line_and_kind_and_never_by_value(packed_secrets, secret_study):
    packed, planted = packed_secrets
    folder, _ = secret_study
    told = {(each.name, line): each.what for each in packed.replaced for line in each.lines}
    for name in (CONFIG, "config/lab.yaml", "config/lab.ini", "config/bringup.launch"):
        lines = (folder / name).read_text(encoding="utf-8").splitlines()
        for each in planted:
            if each.file == name and each.text.count("\n") == 0:
                number = lines.index(each.text) + 1
                assert (name, number) in told, each.kind
    text = json.dumps([asdict(each) for each in (*packed.replaced, *packed.doubtful, *packed.left_out)])
    assert _leaked(planted, {"told": text.encode()}) == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "content"),
    [
        pytest.param("notes.txt", "first line\nthe token is wanderlust and opens the door\n", marks=pytest.mark.soak),
        ("config/clone.sh", "# a comment\ngit clone https://adalovelace@git.example.org/nav.git\n"),
        ("runs/r_1/users.csv", "user,password,n\nada,wanderlust,3\n"),
    ],
)
def test_in_doubt_nothing_is_packed_unless_it_is_told(experiment, tmp_path, robot_runner, name, content):
    folder = Path(shutil.copytree(experiment, tmp_path / "small"))
    (folder / name).write_text(content, encoding="utf-8")
    refused = robot_runner("pack", "small", "--no-wheels")
    assert refused.code == 2
    assert f"{name}:2" in refused.err
    assert "--doubtful keep" in " ".join(refused.err.split())
    assert "wanderlust" not in refused.out + refused.err
    assert not (tmp_path / "small.zip").exists()

    kept = robot_runner("pack", "small", "--no-wheels", "--doubtful", "keep")
    assert kept.code == 0
    assert "kept, though in doubt: what may be a" in kept.out
    assert _contents(tmp_path / "small.zip")[name].decode() == content
    assert robot_runner("pack", "small", "--no-wheels", "--doubtful", "replace", "--to", "b.zip").code == 0
    assert not {b"wanderlust", b"adalovelace"} & set(re.findall(rb"\w+", _contents(tmp_path / "b.zip").get(name, b"")))


@pytest.mark.long
def test_what_cannot_be_looked_into_is_told(experiment, tmp_path, robot_runner):
    folder = Path(shutil.copytree(experiment, tmp_path / "small"))
    (folder / "data.7z").write_bytes(b"7z\xbc\xaf\x27\x1c\0\4" + b"\1\0" * 99)
    with zipfile.ZipFile(folder / "damaged.zip", "w") as archive:
        archive.writestr("a.txt", "x" * 999)
    raw = (folder / "damaged.zip").read_bytes()
    (folder / "damaged.zip").write_bytes(raw[:40])
    answer = robot_runner("pack", "small", "--no-wheels", "--json").json
    assert {each["name"] for each in answer["not_searched"]} == {"data.7z", "damaged.zip"}
    assert "data.7z" in _contents(tmp_path / "small.zip")
