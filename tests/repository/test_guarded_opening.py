"""Files of an experiment folder are opened by `core/storage/guarded_files.py`, and by nothing else."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

SOURCE = Path(__file__).parents[2] / "src" / "robot_runner"
#: What reads or writes experiment folders. Plugins write into a run's new folder, which `RunContext` made.
PACKAGES = (
    *("core/storage", "core/execution", "core/events", "core/config", "cli", "measuring", "notebook"),
    *("adaptive", "analysis", "designs", "meters/power_model", "page", "replication"),
)
OPENERS = {"read_text", "write_text", "read_bytes", "write_bytes", "touch"}
COPIERS = {"copyfile", "copy", "copy2", "copytree"}
READERS = {"read_csv", "open_csv", "read_parquet", "scan_csv"}
#: Openings of other files, and why they are none of an experiment's.
OTHERS: dict[str, str] = {
    place: reason
    for reason, places in {
        "the guarded way itself": (
            "core/storage/guarded_files.py: _beside",
            "core/storage/guarded_files.py: _opened",
            "core/storage/guarded_files.py: _open_regular",
            "core/storage/guarded_paths.py: open_folder",
            "core/storage/system_refusals.py: fsync_folder",
        ),
        "what the system tells of itself: /proc, /sys, installed packages": (
            "core/storage/manifest.py: _processor",
            "core/storage/manifest.py: _governor",
            "core/storage/outliving.py: process_stat",
            "core/storage/outliving.py: program_name",
            "core/storage/manifest.py: _system_packages",
            "core/storage/manifest.py: _sha256",
            "core/execution/left_processes.py: _is_lock",
            "core/storage/lock_files.py: this_boot",
            "core/execution/processes.py: memory_kills",
            "core/storage/outliving.py: has_in_environment",
            "notebook/apart.py: _be_apart",
            "cli/guard.py: _replace_closed_streams",
            "cli/harmless_stream.py: let_go_of",
            "measuring/local_host.py: _first_line",
            "core/execution/processes.py: use_no_streams",
            "core/config/local_modules.py: editable_folders",
            "core/config/claims.py: _quotas",
            "core/config/claims.py: _quota_of",
            "replication/distributions.py: direct_url",
            "replication/distributions.py: fingerprint",
            "replication/distributions.py: wheel_name",
            "replication/distributions.py: write_wheel",
            "replication/distributions.py: _editable_code",
            "replication/distributions.py: _mapped",
            "replication/distributions.py: _path_entries",
            "replication/environment.py: _imports_of",
        ),
        "a folder of the system that all users share, from which nothing is believed": tuple(
            f"core/storage/shared_claims.py: {function}" for function in ("_hold", "_holder", "_let_go", "_locker")
        ),
        "the robot's own computer, by the loop that is sent there": tuple(
            f"measuring/on_board/loop.py: {function}"
            for function in ("__init__", "first_bytes", "first_line", "main", "opened", "send")
        ),
        "the user's own config or module, which is executed anyway": (
            "cli/queueing.py: digest_of",
            "core/execution/manifest_content.py: keep_config_files",
            "core/execution/resumption.py: _changed_files",
            "cli/commands/run.py: settings_to_resume",
            "notebook/python_config.py: _source",
            "core/config/registered_config.py: _digest",
            "core/config/local_modules.py: _digest",
            "core/config/source.py: _read",
            "measuring/own_scripts.py: text_of",
        ),
        "a temporary folder of this process": (
            "cli/commands/demo.py: _rows",
            "cli/trial.py: try_plugin",
            "cli/trial.py: _loaded",
            "replication/index_hashes.py: locked_hashes",
            "replication/index_hashes.py: _dry_run",
            "replication/virtual_environments.py: _make",
            "replication/virtual_environments.py: _call",
            "replication/signatures.py: _allowed_signers",
        ),
        "a file that the user names": (
            "cli/commands/try_.py: _kept",
            "core/config/notify.py: addresses_from",
            "core/storage/input_files.py: _file_digest",
            "core/storage/input_files.py: kept_contents",
            "analysis/commands/power.py: _write",
            "analysis/commands/preregister.py: _power",
            "analysis/plan_file.py: read_toml",
            "meters/power_model/linear_power_model.py: read_model",
            "analysis/planning/means_table.py: _cells_of",
            "replication/signatures.py: sign",
            "replication/signatures.py: _name",
            "replication/signatures.py: _ssh_keygen",
        ),
        "results of other tools, which the user wants imported, into a folder that was made for them": (
            "analysis/importing/adoption.py: _adopted",
            "analysis/importing/adoption.py: _write_samples",
            "analysis/importing/adoption.py: _checksum",
            "analysis/importing/foreign_samples.py: _has_rows",
            "analysis/importing/foreign_table.py: read_foreign_table",
            "analysis/importing/foreign_table.py: dialect_of",
        ),
        "a run's new folder, which its context made": (
            "measuring/meter_process.py: __init__",
            "measuring/meter_process.py: _take",
            "meters/power_model/power_model.py: _keep",
        ),
        "an archive in memory": ("analysis/report/rendering.py: _archive",),
        "part of Robot Runner": (
            "analysis/report/rendering.py: _asset",
            "cli/commands/__init__.py: _read",
            "cli/templating.py: template",
            "measuring/on_board_session.py: _program",
            "page/page_server.py: _asset",
        ),
        "a package that the user names, or a new folder or file made of it": (
            "replication/opening.py: _write",
            "replication/opening.py: _header_faults",
            "replication/plain_zip.py: add",
            "replication/plain_zip.py: written_beside",
            "replication/cleaning.py: _members_of_tar",
        ),
    }.items()
    for place in places
}


def openings(tree: ast.AST, function: str = "") -> Iterator[str]:
    """Yield the function in which each file is opened by its name, by the standard library or pandas."""
    for node in ast.iter_child_nodes(tree):
        inside = node.name if isinstance(node, ast.FunctionDef | ast.ClassDef) else function
        if isinstance(node, ast.Call) and _opens(node):
            yield inside
        yield from openings(node, inside)


def _opens(call: ast.Call) -> bool:
    if isinstance(call.func, ast.Name):
        return call.func.id in {"open", *COPIERS}
    if not isinstance(call.func, ast.Attribute):
        return False
    name, owner = call.func.attr, call.func.value
    owner_name = owner.id if isinstance(owner, ast.Name) else ""
    if name == "open":
        has_mode = any(isinstance(each, ast.Constant) and isinstance(each.value, str) for each in call.args)
        return owner_name == "os" or has_mode or any(each.arg in {"mode", "encoding"} for each in call.keywords)
    return name in OPENERS or (name in COPIERS and owner_name == "shutil") or (name in READERS and owner_name == "pd")


@cache
def found() -> set[str]:
    """Return in which functions of which modules files are opened."""
    return {
        f"{module.relative_to(SOURCE).as_posix()}: {function}"
        for package in PACKAGES
        for module in (SOURCE / package).rglob("*.py")
        for function in openings(ast.parse(module.read_bytes()))
    }


def test_files_of_an_experiment_folder_are_opened_in_one_guarded_way() -> None:
    assert sorted(found() - set(OTHERS)) == []


def test_no_reason_has_outlived_its_opening() -> None:
    assert sorted(set(OTHERS) - found()) == []
    assert all(OTHERS.values())


def test_an_opening_is_noticed() -> None:
    noticed = [
        "open(path)",
        "path.open('rb')",
        "path.open(encoding='utf-8')",
        "(a / b).read_text()",
        "os.open(path, 0)",
        "shutil.copyfile(a, b)",
        "pd.read_csv(path)",
    ]
    passed = ["open_to_read(path)", "read_text(path)", "resources.open(key, opener)", "pd.read_csv"]
    assert [text for text in [*noticed, *passed] if list(openings(ast.parse(text)))] == noticed
