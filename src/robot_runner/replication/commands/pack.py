"""Seal an experiment as one file that anyone can check and execute again.

The package is a zip file and an RO-Crate: config, run table, raw data, circumstances, environment, checksums. Secrets
and home paths are replaced or left out, and listed. Packing twice gives the same bytes.
"""

from __future__ import annotations

from argparse import BooleanOptionalAction, Namespace
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.cli.console import (
    UserConsole,
    command_line,
    complaints,
    output,
    print_facts,
    print_folded,
    print_json,
    shown_path,
)
from robot_runner.cli.findings import as_json, show_findings
from robot_runner.cli.parser import Parser, UsageError, add_json, add_set
from robot_runner.cli.screens.progress_bars import byte_progress
from robot_runner.cli.target import target_or_only
from robot_runner.core.words import counted, one_line

if TYPE_CHECKING:
    from robot_runner.core.config.authors import Author
    from robot_runner.replication.cleaning import Replaced
    from robot_runner.replication.packing import Packed
    from robot_runner.replication.plain_zip import Progress

_MEGABYTE = 1_000_000
#: So many line numbers of one kind and file are printed; package.json has all.
_SHOWN_LINES = 5


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "target",
        metavar="EXPERIMENT",
        nargs="?",
        help="the folder of an experiment, or the config file that it comes from; the only one here if left out",
    )
    add_set(parser)
    parser.add_argument("--to", metavar="FILE", help="the file to write; NAME.zip in the current folder if left out")
    parser.add_argument(
        "--raw",
        metavar="WHOSE",
        action="append",
        help="whose raw data to pack: all (if left out), none, or a plugin's name; may be given several times",
    )
    parser.add_argument(
        "--author",
        metavar="AUTHOR",
        action="append",
        default=[],
        help="'NAME; ORCID; AFFILIATION; URL', instead of those in the config; may be given several times",
    )
    parser.add_argument("--licence", help="an SPDX identifier such as CC-BY-4.0, or a URL, instead of the config's")
    parser.add_argument("--citation", metavar="TEXT", help="the publication to cite, instead of the config's")
    parser.add_argument(
        "--keep",
        metavar="PATTERN",
        action="append",
        default=[],
        help="pack files with matching names unchanged, with any secrets, such as 'runs/*/bag/*'; may be given several "
        "times",
    )
    parser.add_argument(
        "--doubtful",
        metavar="WHAT",
        choices=("refuse", "keep", "replace"),
        default="refuse",
        help="how to treat lines that may hold a secret: `refuse` to pack, and list them (if left out), `keep` them "
        "unchanged, or `replace` the possible secrets",
    )
    parser.add_argument(
        "--no-wheels",
        action="store_true",
        help="leave out the code of packages that were installed from a folder of this machine",
    )
    parser.add_argument(
        "--hashes",
        action=BooleanOptionalAction,
        default=True,
        help="ask the package index of pip's settings for the hashes of needed packages that are not in Robot Runner's "
        "lock, so that pip checks them when the package is replicated (on if left out)",
    )
    parser.add_argument(
        "--base-image",
        metavar="IMAGE",
        help="the base of the container image, best with its digest (NAME:TAG@sha256:DIGITS), instead of the official "
        "image of the experiment's Python or ROS",
    )
    parser.add_argument(
        "--sign", metavar="KEY", help="sign it with this ssh key, such as ~/.ssh/id_ed25519; writes FILE.sig beside it"
    )
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Write the package, and print its contents, the omitted files and the missing facts."""
    folder = target_or_only("pack", arguments.target, arguments.set).root
    authors, licence = _authors(arguments.author), _licence(arguments.licence)
    from robot_runner.replication.container import as_base  # noqa: PLC0415 - only where a package is made
    from robot_runner.replication.packing import pack  # noqa: PLC0415 - takes a while to import
    from robot_runner.replication.sealing import Packing  # noqa: PLC0415 - as above
    from robot_runner.replication.signatures import check_signature, sign, signature_of  # noqa: PLC0415 - as above

    packing = Packing(
        raw=tuple(arguments.raw or ("all",)),
        keep=tuple(arguments.keep),
        doubtful=arguments.doubtful,
        authors=authors,
        licence=licence,
        citation=arguments.citation,
        with_wheels=not arguments.no_wheels,
        with_hashes=arguments.hashes,
        base_image=None if arguments.base_image is None else as_base(arguments.base_image),
    )
    target = Path(arguments.to).expanduser() if arguments.to else Path.cwd() / f"{folder.name}.zip"
    key = _key(arguments.sign)
    with ExitStack() as stack:

        @cache
        def bar() -> Progress:
            return stack.enter_context(byte_progress("packing"))  # messages before it stay legible

        def show(done: int, total: int) -> None:
            bar()(done, total)

        def ask(count: int) -> None:
            stack.close()  # all files are packed now
            asking = f"Asking the package index for the hashes of {counted(count, 'package')}"
            complaints().print(f"{asking}: minutes at most; --no-hashes skips it.", style="dim")

        packed = pack(folder, target, packing, show, ask)
    signature = sign(target, key) if key else None
    if arguments.json:
        told = {"path": str(packed.path), "findings": as_json(packed.findings)}
        print_json({**asdict(packed), **told, "signature": str(signature) if signature else None})
    else:
        _print(output(), packed, signature, has_asked=arguments.hashes)
        if packed.findings:
            show_findings(packed.findings)
    if signature is None and signature_of(target).exists():
        check_signature(target)  # an earlier signature stays valid if the bytes are the same
    return 0


def _key(text: str | None) -> Path | None:
    """Return the path of the signing key; called before packing, so that a missing key is reported early."""
    key = Path(text).expanduser() if text else None
    if key is not None and not key.is_file():
        fix = "Name a key of ssh; `ssh-keygen -t ed25519` makes one."
        raise UsageError("there is no such key", where=str(key), fix=fix)
    return key


def _authors(texts: list[str]) -> tuple[Author, ...]:
    from robot_runner.core.config.authors import authors_from_text  # noqa: PLC0415 - only where it is asked for

    try:
        return tuple(author for text in texts for author in authors_from_text(text))
    except ValueError as error:
        fix = "Write 'NAME; ORCID; AFFILIATION; URL'; what is not known is left out."
        raise UsageError(f"{error} is not an author", where="--author", fix=fix) from error


def _licence(text: str | None) -> str | None:
    from robot_runner.core.config.authors import is_licence  # noqa: PLC0415 - only where it is asked for

    if text is not None and not is_licence(text):
        fix = "Give an identifier of https://spdx.org/licenses/, such as CC-BY-4.0, or a URL."
        raise UsageError(f"{text!r} is not a licence", where="--licence", fix=fix)
    return text


def _print(console: UserConsole, packed: Packed, signature: Path | None, *, has_asked: bool) -> None:
    name = shown_path(packed.path.resolve())
    console.print(Text(name, style="bold"))
    print_facts(
        console,
        [
            ("Holds", f"{counted(packed.file_count, 'file')}, {packed.size / _MEGABYTE:,.1f} MB"),
            ("SHA-256", packed.sha256),
            ("Wheels", ", ".join(packed.wheels)),
            ("Hashes", _hashes(packed, has_asked=has_asked)),
            ("Signed", shown_path(signature.resolve()) if signature else ""),
            ("Next", f"look into it before you publish it, and check it: {command_line('verify', name)}"),
        ],
    )
    lines = [f"replaced: {line}" for line in _listed(packed.replaced)]
    lines += [f"kept, though in doubt: {line}" for line in _listed(packed.doubtful)]
    lines += [f"not searched: {each.name} ({each.why})" for each in packed.not_searched]
    lines += [f"left out: {each.name} ({each.why})" for each in packed.left_out]
    for line in lines:
        print_folded(console, "  - ", one_line(line), style="")


def _hashes(packed: Packed, *, has_asked: bool) -> str:
    """Return the number of packages whose files pip can check; empty if the needed packages are unknown."""
    packages = counted(packed.package_count, "package")
    if not packed.without_hash:
        return f"of all {packages} needed: pip demands them" if packed.package_count else ""
    known = packed.package_count - len(packed.without_hash)
    advice = "" if has_asked else "; without --no-hashes the package index is asked for the others"
    return f"of {known} of {packages} needed: pip demands none{advice}"


def _listed(found: Iterable[Replaced]) -> Iterator[str]:
    """Yield one line for each file and kind of secret; equal files of all runs are one line."""
    grouped: dict[tuple[str, str], list[Replaced]] = {}
    for each in found:
        top, _, rest = each.name.partition("/")
        key = (f"{top}/…/{rest.rpartition('/')[2]}" if rest.count("/") else each.name, each.what)
        grouped.setdefault(key, []).append(each)
    for (name, what), files in grouped.items():
        where = name if len(files) > 1 else _place(files[0])
        in_files = f" in {len(files)} files" if len(files) > 1 else ""
        yield f"{what}, {counted(sum(each.count for each in files), 'time')}{in_files} ({where})"


def _place(found: Replaced) -> str:
    """Return the name of the file, and the first lines with secrets."""
    lines = ", ".join(map(str, found.lines[:_SHOWN_LINES]))
    more = ", ..." if len(found.lines) > _SHOWN_LINES else ""
    return f"{found.name}, line{'s' if len(found.lines) > 1 else ''} {lines}{more}" if lines else found.name
