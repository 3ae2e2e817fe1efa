"""Files that an experiment reads: copies of them, an index, and what is said where there is no copy."""

from __future__ import annotations

import errno
import hashlib
import os
import subprocess
from pathlib import Path

import pytest

from robot_runner.core.errors import StorageError
from robot_runner.core.storage import input_files
from robot_runner.core.storage.guarded_files import read_bytes
from robot_runner.core.storage.input_files import (
    INDEX,
    InputFile,
    copies_in,
    copy_kept,
    input_changes,
    input_file,
    kept_contents,
    kept_copies,
    missing_inputs,
    read_index,
)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Return the folder of a config, with a model below it whose mesh is elsewhere."""
    study = tmp_path / "study"
    for file in ("study/models/rover.xml", "meshes/block.obj"):
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).write_text(file)
    return study


def _keep(study: Path, *inputs: InputFile) -> Path:
    """Keep what is read in the folder of configs of a package on another machine, and return that folder."""
    kept = study.parent / "package" / "config"
    for place, content in kept_contents(inputs, study, kept).items():
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    return kept


def test_what_lies_below_the_config_is_found_by_its_path_although_it_needs_files_elsewhere(study: Path) -> None:
    kept = _keep(study, InputFile(study / "models/rover.xml", (study / "../meshes/block.obj",)))
    with kept_copies(kept):
        found = input_file(kept / "models/../models/rover.xml")
    assert found.read_text() == "study/models/rover.xml"
    assert (found.parent / "../../meshes/block.obj").read_text() == "meshes/block.obj"


def test_a_plugin_may_name_its_file_by_the_text_that_it_was_given(study: Path) -> None:
    kept = _keep(study, InputFile(f"{study}/models/rover.xml", [f"{study}/../meshes/block.obj"]))  # type: ignore[arg-type]
    with kept_copies(kept):
        assert input_file(f"{kept}/models/rover.xml").read_text() == "study/models/rover.xml"
    assert input_file("rover.xml") == Path("rover.xml")


def test_a_file_that_is_called_like_the_index_is_kept_apart_from_it(study: Path) -> None:
    (study / INDEX).write_text("mine")
    kept = _keep(study, InputFile(study / INDEX))
    assert len(read_index(kept)) == 1
    with kept_copies(kept):
        assert input_file(kept / INDEX).read_text() == "mine"


def test_what_lies_in_the_home_folder_is_found_where_the_package_calls_that_folder_by_its_short_name(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = _keep(study, InputFile(study.parent / "meshes/block.obj"))
    index = kept / INDEX
    index.write_text(index.read_text().replace(str(study.parent), "~"))
    monkeypatch.setenv("HOME", "/home/of_somebody_else")
    with kept_copies(kept):
        assert input_file(study.home() / "meshes/block.obj").read_text() == "meshes/block.obj"


def test_what_the_package_leaves_out_by_its_name_is_read_where_it_was(study: Path) -> None:
    secret = study / "robot.key"
    secret.write_text("swordfish")
    kept = _keep(study, InputFile(secret))
    (kept / "robot.key").unlink()
    assert not list(missing_inputs(kept))
    with kept_copies(kept):
        assert input_file(secret) == secret
    secret.unlink()
    (missing,) = missing_inputs(kept)
    assert "there is no copy of it, and it is not here" in missing.problem


def test_of_too_many_files_the_index_tells_the_size(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(input_files, "_MOST_FILES", 1)
    (study / "models/other.xml").write_text("other")
    kept = _keep(study, InputFile(study / "models"))
    (told,) = read_index(kept)
    assert (told["kept"], told["size"]) == (None, len("study/models/rover.xml") + len("other"))
    assert not list(missing_inputs(kept))
    (study / "models/other.xml").write_text("another one")
    (missing,) = missing_inputs(kept)
    assert "the one here is another" in missing.problem
    (change,) = input_changes([InputFile(study / "models")], kept)
    assert change.is_error


def test_a_model_that_is_left_out_is_compared_with_its_meshes(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(input_files, "_LARGEST", 1)
    kept = _keep(study, InputFile(study / "models/rover.xml", (study / "../meshes/block.obj",)))
    assert not list(missing_inputs(kept))
    (study.parent / "meshes/block.obj").write_text("another one")
    assert len(list(missing_inputs(kept))) == 1


@pytest.mark.long
def test_the_largest_copy_can_be_compared_when_the_experiment_goes_on(study: Path) -> None:
    with (study / "hall.mcap").open("wb") as file:
        file.truncate(input_files._LARGEST)
    kept = _keep(study, InputFile(study / "hall.mcap"))
    assert len(read_bytes(kept / "hall.mcap")) == input_files._LARGEST


def test_a_file_that_cannot_be_read_is_named(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rover = InputFile(study / "models/rover.xml")
    kept = _keep(study, rover)

    def refuse(path: Path) -> str:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(input_files, "_file_digest", refuse)
    for read in (lambda: list(input_changes([rover], kept)), lambda: kept_contents([rover], study, kept)):
        with pytest.raises(StorageError, match=r"rover\.xml: the file cannot be read: Permission denied"):
            read()


def test_the_home_folder_of_nobody_is_a_missing_file(study: Path) -> None:
    kept = _keep(study, InputFile(study / "models/rover.xml"))
    (kept / INDEX).write_text((kept / INDEX).read_text().replace(str(study), "~nobody-at-all"))
    (kept / "models/rover.xml").unlink()
    with kept_copies(kept):
        assert input_file(Path("~nobody-at-all/lab.toml")) == Path("~nobody-at-all/lab.toml")
    (finding,) = missing_inputs(kept)
    assert "it is not here" in finding.problem


def test_a_file_whose_name_is_no_text_is_kept_and_summed_as_sha256sum_does(study: Path) -> None:
    folder = study / "models"
    (odd := folder / os.fsdecode(b"rover \xff.xml")).write_text("odd")
    kept = _keep(study, InputFile(folder))
    assert (kept / "models" / odd.name).read_text() == "odd"
    names = sorted(folder.iterdir())
    command = ["sha256sum", *(f"models/{each.name}" for each in names)]
    lines = subprocess.run(command, cwd=study, check=True, capture_output=True).stdout
    assert [each["sha256"] for each in read_index(kept)] == [hashlib.sha256(lines).hexdigest()]
    assert list(input_changes([InputFile(folder)], kept)) == []
    odd.write_text("odder")
    assert list(input_changes([InputFile(folder)], kept))


@pytest.mark.parametrize("is_relative", [True, False])
def test_the_folder_of_the_config_may_be_the_one_that_a_program_is_executed_in(
    is_relative: bool, study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(study)
    model = study / "models/rover.xml"
    kept = _keep(study, InputFile(Path() if is_relative else study, (model,)))
    assert copies_in(kept) == {kept / "models/rover.xml"}
    copy_kept(kept, study.parent / "working")
    with kept_copies(kept, study.parent / "working"):
        assert input_file(kept / "models/rover.xml") == study.parent / "working/models/rover.xml"
        assert input_file(kept / "models/rover.xml").is_file()


def test_a_folder_that_has_another_name_now_is_the_same_input(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(study)
    kept = _keep(study, InputFile(Path(), (study / "models/rover.xml",)))
    moved = study.rename(study.with_name("moved"))
    monkeypatch.chdir(moved)
    own = InputFile(Path(), (moved / "models/rover.xml",))
    assert list(input_changes([own], kept)) == []
    (moved / "models/rover.xml").write_text("wider")
    (changed,) = input_changes([own], kept)
    assert changed.problem == "moved/models/rover.xml is another one than the runs before have read"


def test_programs_of_one_folder_have_each_their_own_files(study: Path) -> None:
    talker, echo = study / "talker.py", study / "echo.py"
    for script in (talker, echo):
        script.write_text(script.name)
    inputs = [InputFile(study, (talker,)), InputFile(study, (echo,))]
    kept = _keep(study, *inputs)
    assert list(input_changes(inputs, kept)) == []
    talker.write_text("louder")
    (changed,) = input_changes(inputs, kept)
    assert changed.problem == "study/talker.py is another one than the runs before have read"
