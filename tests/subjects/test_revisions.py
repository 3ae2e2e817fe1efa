"""Revisions of a repository as treatments: real git, real builds."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.command_line import PROGRAM
from tests.conftest import HEAD, written_config
from tests.core.execution.conftest import Executed, execute_in
from tests.subjects.conftest import Repository, alive, gone
from tests.waiting import wait_until

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import DesignError, ExecutionError
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.subjects import revisions
from robot_runner.subjects.work_tree import cache_folder

if TYPE_CHECKING:
    from collections.abc import Callable

OURS = HEAD.replace("import *\n", "import *\nfrom robot_runner.plugins.systems import Program\n", 1)
BUILD = "echo building; cp planner.sh planner; echo once >>built.txt"
BODY = """
plugins = [Program(["./planner", treatment("Version")], name="Planner", folder=treatment("Version"), ready="plans")]

def launch_mission(self, context):
    version = context.combination["Version"]
    print(Path(version).name, version.commit, (Path(version.path) / "built.txt").read_text())
"""


def table(place: object, names: tuple[str, ...] = ("v1.0", "main"), build: str = BUILD) -> str:
    factor = f"Factor.revisions('Version', {str(place)!r}, {list(names)!r}, build={build!r})"
    return f"    def create_run_table(self):\n        return RunTableModel([{factor}], seed=1, shuffle=False)"


@pytest.fixture
def execute(tmp_path: Path) -> Callable[..., Executed]:
    return partial(execute_in, tmp_path, body=BODY, head=OURS)


@pytest.fixture
def problems(tmp_path: Path) -> Callable[[str], list[str]]:
    def found(run_table: str) -> list[str]:
        return [
            str(finding) for finding in prepare(written_config(tmp_path, BODY, head=OURS, table=run_table)).findings
        ]

    return found


@pytest.mark.parametrize(
    ("is_url", "process"),
    [pytest.param(False, "SPAWN", id="path", marks=pytest.mark.long), pytest.param(True, "FORK", id="url")],
)
def test_each_revision_is_built_once_and_executed(
    execute: Callable[..., Executed], repository: Repository, process: str, is_url: bool
) -> None:
    place = f"file://{repository.folder}" if is_url else repository.folder
    body = f"run_process = RunProcess.{process}\n{BODY}"
    done = execute(body=body, table=table(place))
    assert (done.finished.failures, done.finished.done_count) == ((), 2)
    assert [row["Version"] for row in done.table] == ["v1.0", "main"]
    outputs = [(done.folder / f"runs/r_{number}/Planner/stdout.txt").read_text() for number in (1, 2)]
    assert [output.split()[:2] for output in outputs] == [["old", "plans"], ["new", "plans"]]
    commits = [repository.commit_of(name) for name in ("v1.0", "main")]
    assert [done.log(f"r_{number}").split() for number in (1, 2)] == [["tree", commit, "once"] for commit in commits]
    facts = read_manifest(done.folder / "manifest.json")["revisions"]["Version"]
    assert [each["commit"] for each in facts.values()] == commits
    assert facts["v1.0"]["repository"] == str(place)
    assert done.journal("prepared")[0]["treatments"]["revisions"]["Version"] == facts
    started = done.journal("subject")[0]
    assert started["repository"]["commit"] == commits[0]
    assert "building" in (done.folder / "revisions/Version/v1.0.log").read_text()


@pytest.fixture
def half_done(execute: Callable[..., Executed], repository: Repository) -> tuple[Executed, Callable[[], Executed]]:
    """Return an experiment whose run of `main` has failed, and what goes on with it, successfully."""
    body = BODY + "\n    assert version.name == 'v1.0' or Path(__file__).with_name('go').exists()"
    first = execute(body=body, table=table(repository.folder))
    assert first.finished.failed == ("r_2",)
    (first.config.parent / "go").touch()
    return first, partial(execute, body=body, table=table(repository.folder))


@pytest.mark.long
def test_a_branch_keeps_its_commit_while_the_experiment_goes_on(
    half_done: tuple[Executed, Callable[[], Executed]], repository: Repository
) -> None:
    first, resume = half_done
    before = repository.commit_of("main")
    repository.commit("newer")
    prepared = prepare(first.config)
    (moved,) = [finding.problem for finding in prepared.findings]
    assert moved == (
        f"'main' is {repository.commit_of('main')[:12]} now, and was {before[:12]} when the experiment began, "
        "with which it goes on"
    )
    (first.folder / "manifest.json").unlink()  # the journal knows it as well
    resumed = resume()
    assert resumed.finished.done_count == 2
    assert resumed.log("r_2").split()[1:3] == [before, "once"]


@pytest.mark.long
def test_an_experiment_goes_on_where_the_repository_is_gone(
    half_done: tuple[Executed, Callable[[], Executed]], repository: Repository
) -> None:
    _, resume = half_done
    commit = repository.commit_of("main")
    shutil.rmtree(repository.folder)
    shutil.rmtree(cache_folder())
    resumed = resume()
    assert resumed.finished.done_count == 2
    assert resumed.log("r_2").split()[1:3] == [commit, "once"]


@pytest.mark.long
def test_what_was_built_is_built_again_only_where_it_was_changed(
    execute: Callable[..., Executed], repository: Repository
) -> None:
    execute(table=table(repository.folder))
    (tree,) = cache_folder().glob(f"*-{repository.commit_of('v1.0')[:12]}-*/tree")
    (tree / "planner.sh").write_text("#!/bin/sh\necho by hand; exec sleep 100\n")
    (tree / "built.txt").write_text("")
    done = execute(table=table(repository.folder), experiment_name="again")
    assert done.finished.failures == ()
    assert (done.folder / "runs/r_1/Planner/stdout.txt").read_text().startswith("old plans")
    built = read_manifest(done.folder / "manifest.json")["revisions"]["Version"]
    earlier = read_manifest(done.folder.parent / "trial/manifest.json")["revisions"]["Version"]
    assert built["main"] == earlier["main"]
    assert built["v1.0"]["built_at"] > earlier["v1.0"]["built_at"]


def test_a_build_that_fails_refuses_the_experiment_with_its_last_lines(
    execute: Callable[..., Executed], repository: Repository
) -> None:
    build = "echo compiling; echo 'planner.c:7: no such header' >&2; exit 2"
    with pytest.raises(ExecutionError) as caught:
        execute(table=table(repository.folder, build=build))
    assert caught.value.where == "revision 'v1.0'"
    assert caught.value.problem == "the build ended with exit code 2: compiling | planner.c:7: no such header"
    assert "build.log" in caught.value.fix


def test_a_program_that_the_build_did_not_make_is_found_before_the_first_run(
    execute: Callable[..., Executed], repository: Repository
) -> None:
    with pytest.raises(ExecutionError, match=r"the program '\./planner' is not there"):
        execute(table=table(repository.folder, build="true"))


@pytest.mark.long
def test_ctrl_c_ends_a_build(tmp_path: Path, repository: Repository, token: str) -> None:
    config = written_config(
        tmp_path, BODY, head=OURS, table=table(repository.folder, build=f"sh -c 'sleep 100; :' {token}")
    )
    process = subprocess.Popen([PROGRAM, "run", config], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    deadline = time.monotonic() + 60
    while not alive(token):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert f"Building v1.0 of {repository.folder} ..." in said
    assert gone(token)


@pytest.mark.long
def test_a_build_ends_with_its_killed_execution_and_the_next_one_makes_it_anew(
    tmp_path: Path, repository: Repository, token: str
) -> None:
    build = f"echo begun >>{tmp_path}/builds; test -e {tmp_path}/go || setsid sh -c 'sleep 100; :' {token}; {BUILD}"
    config = written_config(tmp_path, BODY, head=OURS, table=table(repository.folder, build=build))
    process = subprocess.Popen([PROGRAM, "run", config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_until(lambda: alive(token), "it is built")
    process.kill()
    process.wait(60)
    assert gone(token)
    (tmp_path / "go").touch()
    again = subprocess.run([PROGRAM, "run", config], capture_output=True, text=True, timeout=120, check=False)
    assert again.returncode == 0, again.stdout + again.stderr
    assert (tmp_path / "builds").read_text().split() == ["begun"] * 3


def test_what_is_no_revision_is_found_before_anything_is_touched(
    problems: Callable[[str], list[str]], repository: Repository, tmp_path: Path
) -> None:
    where = f"factor 'Version', {repository.folder}"
    assert problems(table(repository.folder, ("v1.1", "main"))) == [
        f"{where}: there is no revision 'v1.1' → Did you mean 'v1.0'?"
    ]
    (url,) = problems(table(f"file://{repository.folder}", ("mian", "main")))
    assert url.endswith("there is no revision 'mian' → Did you mean 'main'?")
    (same,) = problems(table(repository.folder, ("main", repository.commit_of("main"))))
    assert "are one commit" in same
    (none,) = problems(table(tmp_path / "nowhere"))
    assert "there is no folder" in none
    (tmp_path / "plain").mkdir()
    (plain,) = problems(table(tmp_path / "plain"))
    assert "git finds no repository" in plain
    (repository.folder / "src").mkdir()
    (within,) = problems(table(repository.folder / "src"))
    assert within.endswith(f"can be cloned as a whole only → Name {str(repository.folder)!r}.")
    (repository.folder / "planner.sh").write_text("changed")
    (dirty,) = problems(table(repository.folder))
    assert "has changes that were not committed: they are in none of the revisions" in dirty
    assert not cache_folder().exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to another user")
def test_a_repository_of_another_user_is_refused_with_what_git_advises(repository: Repository) -> None:
    for path in (repository.folder, repository.folder / ".git"):
        os.chown(path, 65534, 65534)
    with pytest.raises(ExecutionError, match="git finds no repository: fatal: detected dubious ownership") as caught:
        revisions.Repository(str(repository.folder))
    assert caught.value.fix == f"Execute: git config --global --add safe.directory {repository.folder}"


def test_a_repository_that_ssh_cannot_reach_is_refused_with_the_reason_of_ssh(monkeypatch: pytest.MonkeyPatch) -> None:
    told = (
        b"Warning: Permanently added 'host'\ngit@host: Permission denied (publickey).\n"
        b"fatal: Could not read from remote repository.\n\n"
        b"Please make sure you have the correct access rights\nand the repository exists.\n"
    )
    refused = subprocess.CompletedProcess((), 128, b"", told)
    monkeypatch.setattr(revisions, "git", lambda *_, **__: refused)
    with pytest.raises(ExecutionError, match=r"git finds no repository: git@host: Permission denied \(publickey\)"):
        revisions.Repository("git@host:planner.git")


def test_names_that_cannot_be_revisions_are_refused_by_the_factor() -> None:
    from robot_runner import Factor

    with pytest.raises(DesignError) as caught:
        Factor.revisions("Version", "planner", ["--upload-pack=x", "v1..v2", 3])
    assert len(caught.value.findings) == 3
    (revision,) = Factor.revisions("Version", "planner", ["v1.0"]).treatments
    with pytest.raises(DesignError, match="has no work tree yet"):
        Path(revision)


@pytest.mark.long
def test_the_commit_of_the_config_and_what_was_not_committed_are_kept(tmp_path: Path, repository: Repository) -> None:
    folder = repository.folder
    written_config(folder, "", head=HEAD)
    repository.git("add", "config.py")
    repository.git("commit", "--quiet", "-m", "a study")
    repository.git("remote", "add", "origin", "https://me:secret@example.org/study.git")

    def executed(name: str) -> tuple[dict[str, object], Path]:
        done = execute_in(folder, "", head=HEAD, experiment_name=name)
        recorded = read_manifest(done.folder / "manifest.json")["executions"][-1]["repository"]
        assert done.journal("experiment_started")[-1]["repository"] == recorded
        return recorded, done.folder

    clean, _ = executed("clean")
    origin = "https://example.org/study.git"
    assert clean == {"commit": repository.commit_of("main"), "branch": "main", "origin": origin, "is_dirty": False}
    (folder / "planner.sh").write_text("#!/bin/sh\necho quick\n")
    dirty, kept = executed("dirty")
    assert dirty["is_dirty"] is True
    diff = (kept / str(dirty["diff"])).read_text()
    assert "+echo quick" in diff
    repository.git("stash", "--quiet")
    subprocess.run(["git", "apply", kept / str(dirty["diff"])], cwd=folder, check=True)
    assert "quick" in (folder / "planner.sh").read_text()


def test_where_there_is_no_git_or_no_repository_nothing_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    for number, path in enumerate((os.environ["PATH"], "/nowhere")):
        monkeypatch.setenv("PATH", path)
        done = execute_in(tmp_path, experiment_name=f"n{number}")
        assert "repository" not in json.loads((done.folder / "manifest.json").read_text())["executions"][0]
