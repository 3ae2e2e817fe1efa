"""The image of a package is built by its own recipe from nothing but this system's packages, and ends in a verdict."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from tests.linked_environment import locked_names, make_linked_environment
from tests.replication.small_experiment import write_config

from robot_runner.replication.distributions import (
    closure,
    installed_distributions,
    packages_of_extra,
    wheel_name,
    wheel_of,
    write_wheel,
)

ROOT = Path(__file__).parents[2]
SYSTEM = ("base-files", "coreutils", "dash", "libc-bin", "python3", "python3-venv")


def _why_not() -> str:
    if missing := [name for name in ("buildah", "dpkg-query", "tar") if shutil.which(name) is None]:
        return f"not installed: {', '.join(missing)}"
    if os.geteuid() != 0:
        return "buildah without an engine needs root here"
    python = Path("/usr/bin/python3")
    version = subprocess.run([python, "-V"], capture_output=True, text=True, check=False).stdout.split()[-1:]
    own = f"{sys.version_info.major}.{sys.version_info.minor}."
    return "" if version and version[0].startswith(own) else "the system's Python is another one than the tests'"


pytestmark = [pytest.mark.soak, pytest.mark.timeout(1800)]


@pytest.fixture
def buildah(tmp_path):
    """Return what calls buildah, with a storage of the test's own."""
    if why := _why_not():
        pytest.skip(why)
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": str(tmp_path),
        "STORAGE_DRIVER": "vfs",
        "BUILDAH_ISOLATION": "chroot",
        "TMPDIR": str(tmp_path),
    }
    storage = ["--root", str(tmp_path / "storage"), "--runroot", str(tmp_path / "run")]

    def call(*words, code=0):
        command = ["buildah", *storage, *map(str, words)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=1500, check=False)
        assert done.returncode == code, done.stdout[-3000:] + done.stderr[-3000:]
        return done.stdout

    yield call
    call("rm", "--all")
    call("rmi", "--all", "--force")


def test_the_image_executes_compares_and_ends_in_the_verdicts_exit_code(buildah, tmp_path):
    wheels = _wheels(tmp_path / "wheels", locked_names(ROOT / "requirements" / "demo.txt"))
    package = _package(tmp_path)
    _base(buildah, tmp_path / "rootfs", "localhost/system-python")
    buildah(
        *("build", "--build-arg", "BASE=localhost/system-python"),
        *("--build-arg", "PIP_OPTIONS=--no-index --find-links /wheels", "-v", f"{wheels}:/wheels:ro"),
        *("-t", "small", package),
    )
    config = json.loads(buildah("inspect", "--type", "image", "small"))["OCIv1"]["config"]
    words = [*config["Entrypoint"], *config["Cmd"]]
    assert words[0] == "/opt/comparison/bin/robot-runner"
    container = buildah("from", "small").strip()
    results = tmp_path / "results"
    results.mkdir()
    # Buildah, unlike podman, mounts the image's own volume over a folder that is mounted at /results.
    run = ("run", "-v", f"{results}:/output", container, "--")
    place = words.index("/results/replication")
    told = buildah(*run, *words[:place], "/output/replication", *words[place + 1 :])
    assert told.endswith("The results are identical: every value of 4 runs, to the last digit.\n")
    assert json.loads((results / "replication" / "verdict.json").read_text("utf-8"))["verdict"] == "identical"
    assert (results / "replication" / "comparison.html").is_file()
    words[place] = "/output/other"
    told = buildah(*run, *words, "--set", "robot=simulated:task_power_factor=3", code=3)
    assert told.endswith("The results are different: Energy.\n")


def _wheels(folder, names):
    """Make a wheel of each distribution that is installed here, for want of a package index."""
    folder.mkdir()
    for name in sorted(set(names)):
        found = installed_distributions().get(re.sub(r"[-_.]+", "-", name).lower())
        if found is not None:
            write_wheel(wheel_of(found), folder / wheel_name(found))
    return folder


def _package(tmp_path):
    """Execute and pack a small experiment where nothing is installed but what that needs; return it unpacked."""
    extras = packages_of_extra("robot-runner", "sim") | packages_of_extra("robot-runner", "replication")
    names = closure({"rich", "editables", *extras})
    program = make_linked_environment(tmp_path / "lean", names, code=ROOT / "src")
    _forget_the_lock(tmp_path / "lean")
    config = write_config(tmp_path / "study")
    environment = {"PATH": os.defpath, "HOME": str(tmp_path), "PIP_NO_INDEX": "1"}
    for command in (
        [config],
        ["pack", config.parent / "results" / "small", "--no-hashes", "--to", tmp_path / "small.zip"],
    ):
        done = subprocess.run(
            [program, *command], cwd=config.parent, env=environment, capture_output=True, timeout=300, check=False
        )
        assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(tmp_path / "small.zip") as archive:
        archive.extractall(tmp_path / "package")
    return tmp_path / "package"


def _forget_the_lock(environment):
    """Have no lock at hand: its hashes are of the index's wheels, and those here are made of what is installed."""
    path = next(environment.glob("lib/python*/site-packages/robot_runner-*.dist-info/direct_url.json"))
    origin = json.loads(path.read_text("utf-8"))
    path.unlink()  # it is a link to that of the tests' own environment
    path.write_text(json.dumps(origin | {"url": (environment / "no lock here").as_uri()}), encoding="utf-8")


def _base(buildah, rootfs, name):
    """Make an image of the files of this system's packages, as no registry of images is reachable everywhere."""
    for link in ("bin", "lib", "lib64", "sbin"):  # Debian keeps all of them in /usr
        (rootfs / "usr" / link).mkdir(parents=True, exist_ok=True)
        (rootfs / link).symlink_to(f"usr/{link}")
    for folder, mode in (("tmp", 0o1777), ("root", 0o700), ("proc", 0o555), ("dev", 0o755), ("etc", 0o755)):
        (rootfs / folder).mkdir()
        (rootfs / folder).chmod(mode)
    files = "\0".join(sorted(_files(_needed_packages(SYSTEM)))).encode()
    packed = ["tar", "-C", "/", "--null", "--no-recursion", "-T", "-", "-cf", str(rootfs.with_suffix(".tar"))]
    subprocess.run(packed, input=files, check=True, timeout=300)
    subprocess.run(["tar", "-C", rootfs, "-xf", rootfs.with_suffix(".tar")], check=True, timeout=300)
    container = buildah("from", "scratch").strip()
    buildah("add", container, rootfs, "/")
    buildah("commit", container, name)
    buildah("rm", container)


def _needed_packages(names):
    asked = ["dpkg-query", "-W", "-f", "${db:Status-Abbrev}|${Package}|${Pre-Depends}, ${Depends}|${Provides}\n"]
    told = subprocess.run(asked, capture_output=True, text=True, check=True, timeout=60).stdout
    depends, provided = {}, {}
    for state, package, needs, provides in (line.split("|", 3) for line in told.replace(" | ", " OR ").splitlines()):
        if state.startswith("ii"):
            depends[package] = [re.split(r"[\s:(]", each.strip())[0] for each in needs.split(",")]
            provided |= {each.strip().split(" ")[0]: package for each in provides.split(",")}
    pending, found = list(names), set()
    while pending:
        name = pending.pop()
        name = name if name in depends else provided.get(name, "")
        if name and name not in found:
            found.add(name)
            pending += depends[name]
    return sorted(found)


def _files(packages):
    """Yield the files of Debian packages by where they really are, folders and links that lead elsewhere included."""
    told = subprocess.run(["dpkg-query", "-L", *packages], capture_output=True, text=True, check=True, timeout=60)
    for line in told.stdout.splitlines():
        path = Path(line)
        if path.is_absolute() and path.name and (path.is_file() or path.is_symlink()):
            yield str((path.parent.resolve() / path.name).relative_to("/"))
