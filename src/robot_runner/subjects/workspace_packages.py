"""Which packages are in the sourced workspaces of ROS: names, versions and the git commits of their sources.

A program that prints JSON; it is executed on the subject's computer by its Python, 3.6 or later. Packages of the
system, below /opt and /usr, are left out: the manifest names the distribution.
"""

# ruff: noqa: PTH100, PTH118, PTH120, PTH112, PTH123, UP031

import json
import os
import re
import subprocess
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator

#: The most packages that are printed: a workspace of a robot has some tens.
MOST = 500
#: How deep below `src` of a workspace, or below an entry of ROS_PACKAGE_PATH, to search for packages.
DEPTH = 5
SYSTEM = ("/opt/", "/usr/")
VARIABLES = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH")


def prefixes() -> "list[str]":
    """Return the folders in which workspaces are installed, without the system's."""
    found = [entry for name in VARIABLES for entry in os.environ.get(name, "").split(os.pathsep) if entry]
    return [os.path.abspath(each) for each in found if not each.startswith(SYSTEM)]


def sources() -> "list[str]":
    """Return folders that may have sources: beside the installation of a workspace, and on ROS_PACKAGE_PATH."""
    found: list[str] = []
    for prefix in prefixes():
        # install/<package>, install, devel: the workspace is one or two folders up.
        above = (os.path.dirname(prefix), os.path.dirname(os.path.dirname(prefix)))
        found += [os.path.join(folder, "src") for folder in above]
    on_path = [each for each in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if each]
    found += [os.path.abspath(each) for each in on_path if not each.startswith(SYSTEM)]
    return list(dict.fromkeys(each for each in found if os.path.isdir(each)))


def manifests(root: str) -> "Iterator[str]":
    """Yield the package.xml of each package below a folder; there are no packages within packages."""
    deepest = root.rstrip(os.sep).count(os.sep) + DEPTH
    for folder, names, files in os.walk(root):
        names.sort()
        if "package.xml" in files:
            yield os.path.join(folder, "package.xml")
            names[:] = []
        elif folder.count(os.sep) >= deepest:
            names[:] = []
        else:
            names[:] = [name for name in names if not name.startswith(".")]


def described(path: str) -> "list[str]":
    """Return name and version of a package.xml."""
    with open(path, encoding="utf-8", errors="replace") as file:
        text = file.read(65536)
    found = [re.search(r"<%s[^>]*>\s*([^<\s]+)\s*</%s>" % (tag, tag), text) for tag in ("name", "version")]
    return [each.group(1) if each else "" for each in found]


def git(folder: str, *words: str) -> str:
    """Return git's output for a folder; empty where it fails."""
    environment = dict(os.environ, GIT_OPTIONAL_LOCKS="0", LC_ALL="C")
    command = ["git", "-c", "core.fsmonitor=false", "-C", folder, *words]
    try:
        done = subprocess.run(  # noqa: S603 - an argument list
            command,
            check=False,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.decode("utf-8", "replace").strip() if done.returncode == 0 else ""


def commit(folder: str, known: "dict[str, dict[str, object]]") -> "dict[str, object]":
    """Return the commit of a folder, and whether files were changed; `known` keeps that for each repository."""
    root = git(folder, "rev-parse", "--show-toplevel")
    if not root:
        return {}
    if root not in known:
        changed = git(root, "status", "--porcelain", "--untracked-files=no")
        known[root] = {"commit": git(root, "rev-parse", "HEAD"), "is_dirty": bool(changed)}
    return known[root]


def packages() -> "dict[str, dict[str, object]]":
    """Return version and commit of each package, by its name; one without sources only has a version."""
    found: dict[str, dict[str, object]] = {}
    known: dict[str, dict[str, object]] = {}
    roots = sources() + [os.path.join(prefix, "share") for prefix in prefixes()]
    for path in (path for root in roots for path in manifests(root)):
        name, version = described(path)
        if name and name not in found and len(found) < MOST:
            found[name] = dict(version=version, **commit(os.path.dirname(path), known))
    return found


if __name__ == "__main__":
    sys.stdout.write(json.dumps(packages(), sort_keys=True) + "\n")
