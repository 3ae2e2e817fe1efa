"""Check whether a package is intact.

Nothing is unpacked and nothing is executed. Exit code 0: intact; 2: refused.
"""

from __future__ import annotations

import re
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.cli.console import command_line, output, print_facts, print_json
from robot_runner.cli.findings import as_json, show_findings
from robot_runner.cli.guard import REFUSED
from robot_runner.cli.parser import Parser, UsageError, add_json
from robot_runner.cli.screens.progress_bars import byte_progress
from robot_runner.cli.target import only_package
from robot_runner.core.words import counted, one_line

if TYPE_CHECKING:
    from robot_runner.replication.signatures import Signer
    from robot_runner.replication.verification import Verification

_MEGABYTE = 1_000_000
_SHA256 = re.compile("[0-9a-f]{64}")


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "package",
        metavar="PACKAGE",
        nargs="?",
        help="the package, or the folder that it was unpacked to; the only zip file here if left out",
    )
    parser.add_argument(
        "--sha256", metavar="DIGITS", help="the SHA-256 that its authors published, to check who made it"
    )
    parser.add_argument(
        "--signed-by",
        metavar="FILE",
        help="refuse it unless one of these signed it: public keys, one a line, or allowed signers (ssh-keygen)",
    )
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Verify the package, and print its problems."""
    path = Path(arguments.package or only_package("verify")).expanduser()
    digest = _sha256(path, arguments.sha256) if arguments.sha256 is not None else None
    from robot_runner.replication.opening import open_package  # noqa: PLC0415 - for a quick --help
    from robot_runner.replication.verification import verify_package  # noqa: PLC0415 - as above

    with open_package(path) as package, byte_progress("verifying") as progress:
        verification = verify_package(package, progress)
    digest = digest or _sha256(path, None)  # last, so that a file that is not a package is not read to its end
    signer = _signer(path, arguments.signed_by)
    if arguments.json:
        print_json(
            {
                "package": str(path),
                "sha256": digest,
                "signed_with": signer.key if signer else None,
                "signed_by": signer.name if signer else None,
                "is_intact": verification.is_intact,
                "experiment": verification.experiment,
                "file_count": verification.file_count,
                "size": verification.size,
                "description": verification.description,
                "findings": as_json(verification.findings),
            }
        )
    elif verification.is_intact:
        _print(verification, digest, signer)
    else:
        show_findings(verification.findings)
    return 0 if verification.is_intact else REFUSED


def _sha256(path: Path, expected: str | None) -> str | None:
    wanted = None if expected is None else expected.strip().casefold().removeprefix("sha256:")
    if wanted is not None and not _SHA256.fullmatch(wanted):
        raise UsageError(f"{expected!r} is not a SHA-256", where="--sha256", fix="Give its 64 hexadecimal digits.")
    if not path.is_file():
        if wanted is not None:
            raise UsageError("a folder has no SHA-256", where="--sha256", fix="Name the zip file.")
        return None
    from robot_runner.core.storage.guarded_files import sha256_of  # noqa: PLC0415 - as above

    digest = sha256_of(path)
    if wanted not in {None, digest}:
        fix = "Get the package again from where its authors published it."
        raise UsageError(f"the package's SHA-256 is {digest}, not {wanted}", where=str(path), fix=fix)
    return digest


def _signer(path: Path, trusted: str | None) -> Signer | None:
    """Return the signer of the package; None if it has no signature and needs none."""
    from robot_runner.replication.signatures import check_signature, signature_of  # noqa: PLC0415 - as above

    if not path.is_file():
        if trusted:
            fix = "Name the zip file; its signature lies beside it."
            raise UsageError("a folder has no signature", where="--signed-by", fix=fix)
        return None
    if trusted is None and not signature_of(path).exists():
        return None
    return check_signature(path, Path(trusted).expanduser() if trusted else None)


def _signature(signer: Signer | None) -> str:
    if signer is None:
        return ""
    if signer.name:
        return one_line(f"by {signer.name}, with the key {signer.key}")
    return f"with the key {signer.key}; whose it is, only --signed-by tells"


def _print(verification: Verification, digest: str | None, signer: Signer | None) -> None:
    console = output()
    console.print(Text(one_line(verification.experiment), style="bold").append("  intact", style="green"))
    again = f"execute it again: {command_line('replicate', str(verification.where))}"
    absent = [f"{each.get('name')} ({each.get('why')})" for each in verification.description.get("left_out", ())]
    print_facts(
        console,
        [
            ("Holds", f"{counted(verification.file_count, 'file')}, {verification.size / _MEGABYTE:,.1f} MB unpacked"),
            ("Made by", one_line(str(verification.description.get("made_by", "")))),
            ("SHA-256", digest or ""),
            ("Signed", _signature(signer)),
            ("Left out", one_line(", ".join(absent))),
            ("Next", again if verification.has_config else "read it: it has no config to execute"),
        ],
    )
