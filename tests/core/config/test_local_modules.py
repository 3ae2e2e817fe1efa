"""The modules that a config imports and nobody can install: which they are, and where they are kept."""

from __future__ import annotations

import json
import pathlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from zipfile import ZipFile

import pytest

from robot_runner.core.config.loader import load_config
from robot_runner.core.config.local_modules import (
    check_neighbours,
    editable_code,
    editable_folders,
    imported_files,
    is_local,
    local_modules_among,
)

Write = Callable[..., Path]

CONFIG = """\
import sys
sys.path.insert(0, {elsewhere!r})
import {module}
class RobotRunnerConfig:
    pass
"""


@pytest.fixture(autouse=True)
def as_before():
    path, modules = list(sys.path), set(sys.modules)
    editable_folders.cache_clear()
    yield
    editable_folders.cache_clear()
    sys.path[:] = path
    for name in set(sys.modules) - modules:
        del sys.modules[name]


def written(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def places(config: Path) -> dict[str, Path]:
    return {place.as_posix(): path for path, place in load_config(config).local_modules.items()}


def test_what_callbacks_import_beside_the_config_is_known_before_they_are_called(
    write_config: Write, tmp_path: Path
) -> None:
    files = {
        "asked_late.py": "from parts_of_it.inner import leaf",
        "parts_of_it/__init__.py": "",
        "parts_of_it/inner/branch.py": "not Python",
        "parts_of_it/inner/leaf.py": "def grow():\n    from . import branch",
        "robot_runner/words.py": "",
        "unasked.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    head = """\
class RobotRunnerConfig:
    def launch_mission(self, context):
        import asked_late, json, no_such_module, robot_runner.words
"""
    known = {path.relative_to(tmp_path).as_posix() for path in load_config(write_config(head=head)).local_modules}
    assert known == files.keys() - {"robot_runner/words.py", "unasked.py"}


def test_pythons_own_modules_and_ours_are_none_of_a_config_s_although_they_lie_below_its_folder(
    write_config: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As where a config stands in the home folder, and Python (conda, pyenv) or our clone below it.
    (tmp_path / "helper.py").write_text("import csv", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    config = write_config(head="import helper, json, numpy, robot_runner.plugins", table="")
    assert set(imported_files({config: Path(config.name)}, Path(tmp_path.anchor))) == {config, tmp_path / "helper.py"}
    for own in (json.__file__, pathlib.__file__, load_config.__code__.co_filename, pytest.__file__):
        assert not is_local(Path(own), Path(tmp_path.anchor)), own


def test_modules_from_elsewhere_are_kept_where_a_config_beside_them_imports_them(tmp_path: Path) -> None:
    files = {
        "shared_by_studies.py": "import parts_of_studies.inner",
        "parts_of_studies/__init__.py": "",
        "parts_of_studies/inner.py": "def late():\n    from . import leaf\n    from .. import nothing",
        "parts_of_studies/leaf.py": "",
        "parts_of_studies/unasked.py": "",
        "without_init/leaf.py": "",
        "numpy.py": "a name that is installed, too, and that nobody asks for",
    }
    elsewhere = written(tmp_path / "elsewhere", files)
    config = written(
        tmp_path / "study",
        {
            "config.py": CONFIG.format(elsewhere=str(elsewhere), module="shared_by_studies, json")
            + "    def launch_mission(self, context):\n        from without_init import leaf\n        import beside\n",
            "beside.py": "",
        },
    )
    found = places(config / "config.py")
    assert found.keys() == files.keys() - {"parts_of_studies/unasked.py", "numpy.py"} | {"beside.py"}
    assert found["without_init/leaf.py"] == elsewhere / "without_init" / "leaf.py"


@pytest.mark.parametrize(
    ("folder", "where", "place"),
    [
        ("..", "shared_words.py", "shared_words.py"),
        ("below/../kept", "study/kept/shared_words.py", "kept/shared_words.py"),
    ],
)
def test_modules_are_kept_from_a_folder_that_is_named_by_dots(
    tmp_path: Path, folder: str, where: str, place: str
) -> None:
    written(tmp_path, {where: "", "study/below/other.py": ""})
    elsewhere = f"{tmp_path}/study/{folder}"
    text = CONFIG.format(elsewhere=elsewhere, module="shared_words")
    config = written(tmp_path, {"study/config.py": text}) / "study" / "config.py"
    assert places(config) == {place: tmp_path / where}


def test_modules_in_an_archive_or_without_their_file_are_imported_and_not_kept(tmp_path: Path) -> None:
    archive = tmp_path / "parts.zip"
    with ZipFile(archive, "w") as file:
        file.writestr("part_of_archive.py", "NAME = 'archived'")
    written(tmp_path, {"gone_soon.py": "from pathlib import Path\nPath(__file__).unlink()"})
    text = CONFIG.format(elsewhere=str(archive), module="part_of_archive, gone_soon")
    written(tmp_path, {"config.py": text.replace("pass", "experiment_name = part_of_archive.NAME")})
    loaded = load_config(tmp_path / "config.py")
    assert loaded.config.experiment_name == "archived"
    assert loaded.local_modules == {}


@pytest.mark.parametrize("program", ["../bin/robot-runner", ".venv/bin/robot-runner"])
def test_the_program_is_no_module_of_a_config_that_imports_multiprocessing(
    write_config: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str
) -> None:
    main = ModuleType("__main__")
    main.__file__ = f"{tmp_path}/{program}"
    monkeypatch.setitem(sys.modules, "__mp_main__", main)  # as `multiprocessing` does when it is imported
    assert local_modules_among(write_config(), {"__mp_main__"}) == {}


@pytest.mark.parametrize(("way", "where"), [("insert(0, ", "elsewhere"), ("append(", "study")])
def test_of_two_files_of_one_name_the_one_is_kept_that_is_imported(tmp_path: Path, way: str, where: str) -> None:
    elsewhere = written(tmp_path / "elsewhere", {"called_the_same.py": ""})
    head = CONFIG.format(elsewhere=str(elsewhere), module="json").replace("insert(0, ", way)
    callback = "    def launch_mission(self, context):\n        import called_the_same\n"
    study = written(tmp_path / "study", {"config.py": head + callback, "called_the_same.py": ""})
    assert places(study / "config.py") == {"called_the_same.py": tmp_path / where / "called_the_same.py"}


def test_what_stands_in_for_a_module_keeps_nothing_of_the_one_it_stands_in_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = written(
        tmp_path / "elsewhere", {"of_an_earlier_tool/__init__.py": "", "of_an_earlier_tool/part.py": ""}
    )
    stand_in = type(sys)("of_an_earlier_tool")
    stand_in.part = None
    monkeypatch.setitem(sys.modules, "of_an_earlier_tool", stand_in)
    head = CONFIG.format(elsewhere=str(elsewhere), module="of_an_earlier_tool")
    config = written(tmp_path / "study", {"config.py": head + "    from of_an_earlier_tool import part\n"})
    assert places(config / "config.py") == {}


@pytest.mark.parametrize("answers", ["raise AttributeError(name)", "return 1"])
def test_a_module_that_puts_an_object_in_its_own_place_is_kept(tmp_path: Path, answers: str) -> None:
    text = f"""
import sys
class Settings:
    def __getattr__(self, name):
        {answers}
sys.modules[__name__] = Settings()
"""
    head = CONFIG.format(elsewhere=str(tmp_path / "elsewhere"), module="settings_of_it, settings_of_all")
    written(tmp_path, {"elsewhere/settings_of_all.py": text, "study/settings_of_it.py": text, "study/config.py": head})
    assert places(tmp_path / "study" / "config.py").keys() == {"settings_of_all.py", "settings_of_it.py"}


def test_a_module_that_another_package_imports_late_and_in_vain_is_none_of_a_config_s(
    write_config: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Late:
        def __getattr__(self, name: str) -> None:
            raise ModuleNotFoundError(name)

    monkeypatch.setitem(sys.modules, "moved_modules_of_others", Late())  # as a notebook may have some
    assert local_modules_among(write_config(), {"moved_modules_of_others"}) == {}


def test_modules_in_a_folder_that_is_called_like_a_module_of_pythons_are_kept(tmp_path: Path) -> None:
    files = {"code/parts_of_this/__init__.py": "", "code/parts_of_this/leaf.py": ""}
    late = {"code/parts_of_this/late.py": "def grow():\n    from . import leaf\n"}
    head = CONFIG.format(elsewhere=str(tmp_path / "code"), module="code, parts_of_this.late")
    config = written(tmp_path, files | late | {"config.py": head}) / "config.py"
    assert places(config).keys() == (files | late).keys()


def test_what_is_installed_is_not_kept(tmp_path: Path) -> None:
    installed = written(tmp_path / "venv" / "site-packages", {"of_an_installer.py": ""})
    config = written(
        tmp_path / "study", {"config.py": CONFIG.format(elsewhere=str(installed), module="of_an_installer")}
    )
    assert places(config / "config.py") == {}


def installed_as_it_stands(tmp_path: Path) -> Path:
    """Return a folder with a package, as pip and uv leave it where it is installed with --editable."""
    project = written(
        tmp_path / "a lab's tools",
        {"src/tools_of_a_lab/__init__.py": "GAIN = 2\n", "src/tools_of_a_lab/more.py": ""},
    )
    told = {"url": project.as_uri(), "dir_info": {"editable": True}}
    site = written(
        tmp_path / "site",
        {
            "lab_tools-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: lab-tools\nVersion: 1.0\n",
            "lab_tools-1.0.dist-info/direct_url.json": json.dumps(told),
            "damaged-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: damaged\nVersion: 1.0\n",
            "damaged-1.0.dist-info/direct_url.json": "[1",
        },
    )
    sys.path[:0] = [str(site), str(project / "src")]
    return project


def test_what_is_installed_as_it_stands_is_not_kept_but_known_by_its_code(tmp_path: Path) -> None:
    project = installed_as_it_stands(tmp_path)
    study = written(tmp_path / "study", {"config.py": CONFIG.format(elsewhere=str(tmp_path), module="tools_of_a_lab")})
    assert places(study / "config.py") == {}
    first = editable_code()
    assert first.keys() == {"lab-tools"}
    assert editable_code() == first
    (project / "src/tools_of_a_lab/more.py").write_text("NEW = 1")
    assert editable_code()["lab-tools"] != first["lab-tools"]


def test_a_file_beside_the_config_that_takes_the_place_of_another_module_is_warned_of(tmp_path: Path) -> None:
    """With a `numpy.py` the experiment ended in a fault of ours, and nothing named the file."""
    names = ["random.py", "numpy.py", "test.py", "config.py", "helper.py", "queue/__init__.py", "pytest/__init__.py"]
    names += ["plot.numpy.py", "random.old.py", "random.old/__init__.py"]  # no import statement can name these
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = {Path(each.where).name: each.problem for each in check_neighbours(tmp_path)}
    assert found == {
        "numpy.py": "the file is called like the installed module 'numpy', and is imported in its place",
        "queue": "the file is called like Python's own module 'queue', and is imported in its place",
        "random.py": "the file is called like Python's own module 'random', and is imported in its place",
    }
