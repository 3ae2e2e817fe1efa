"""What a package needs that is not installed here, found without executing anything of it."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from robot_runner.dialects.stand_ins.catalogue import MODULES, PACKAGES
from robot_runner.errors import Finding
from robot_runner.replication.environment import imported_names

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

__all__ = ["lacking"]

#: What configs of the paper and of the earlier tools import, and Robot Runner itself brings.
_BROUGHT = frozenset(name.partition(".")[0] for name in (*MODULES, *PACKAGES, "plugins"))


def lacking(root: Path, manifest: Mapping[str, Any]) -> list[Finding]:
    """Return the plugins and modules that the experiment in an unpacked package needs and that are not here.

    Raises:
        OSError: a file of the config cannot be read.
    """
    config = root / "config"
    local = {path.relative_to(config).parts[0].removesuffix(".py") for path in config.rglob("*.py")}
    return [*_plugins(manifest, local), *_modules(config, manifest, local)]


def _plugins(manifest: Mapping[str, Any], local: set[str]) -> Iterator[Finding]:
    for plugin in manifest.get("plugins", ()):
        module, _, kind = str(plugin.get("class", "")).partition(":")
        if module.partition(".")[0] in {*local, "robot_runner_config"} or _is_installed(module):
            continue
        package, release = plugin.get("package"), plugin.get("version")
        fix = (
            f"Install it: pip install {package}=={release}" if package else f"Install what brings the module {module}."
        )
        yield Finding.error(f"plugin {plugin.get('name')}", f"{kind}, of {package or module}, is not installed", fix)


def _modules(config: Path, manifest: Mapping[str, Any], local: set[str]) -> Iterator[Finding]:
    known = {*local, *_BROUGHT, *sys.stdlib_module_names, "robot_runner"}
    told = {str(plugin.get("class", "")).partition(".")[0] for plugin in manifest.get("plugins", ())}
    for name in sorted(imported_names(config) - known - told):
        if not _is_installed(name):
            fix = "Install the package that brings it, or have the environment made: --environment venv"
            yield Finding.error("config", f"it imports {name}, which is not installed", fix)


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # a package above it is not there
        return False
