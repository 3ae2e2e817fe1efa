"""Sign packages, and check their signatures, by OpenSSH's `ssh-keygen`.

The format is https://github.com/openssh/openssh-portable/blob/master/PROTOCOL.sshsig. The program comes with ssh, most
users have a key, and their public keys are published already. The signature is a separate file, `PACKAGE.sig`.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from robot_runner.core.errors import PackageError
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.storage.system_refusals import storage_error

#: The namespace of the signature: signatures of commits or e-mails are refused.
_NAMESPACE = "robot-runner-package"
#: Enough to read a package of many gigabytes, and to type a passphrase.
_DEADLINE_S = 600.0
#: The largest accepted signature, bytes; one by the largest key has a few kilobytes.
_LARGEST = 64 << 10
_KEY_TYPES = ("ssh-", "ecdsa-", "sk-ssh-", "sk-ecdsa-")
_FINGERPRINT = re.compile(r"with (\S+) key (SHA256:[A-Za-z0-9+/=]+)")
_GET_IT_AGAIN = "Get the package and its signature again from where their authors published them."


@dataclass(frozen=True, slots=True)
class Signer:
    """The signer of a package.

    Attributes:
        key: the type and the fingerprint of the key.
        name: the owner of the key in the file of trusted signers; None without such a file.
    """

    key: str
    name: str | None = None


def signature_of(package: Path) -> Path:
    """Return the path of a package's signature."""
    return package.with_name(f"{package.name}.sig")


def sign(package: Path, key: Path) -> Path:
    """Sign a package; the signature is written beside it, and replaces an earlier one.

    Args:
        package: the zip file.
        key: the private key, or the public key if the ssh agent has the private one. ssh-keygen asks for a passphrase
            on the terminal.

    Raises:
        PackageError: signing with this key failed; the package is unchanged.
        StorageError: the signature cannot be written.
    """
    target = signature_of(package)
    with tempfile.TemporaryDirectory(prefix="robot-runner-signature-") as folder:
        # ssh-keygen writes the signature beside the signed file, and asks before it replaces one.
        link, made = Path(folder, "package"), Path(folder, "package.sig")
        link.symlink_to(package.resolve())
        answer = _ssh_keygen(["-Y", "sign", "-f", str(key), "-n", _NAMESPACE, str(link)])
        if answer.returncode or not made.exists():
            fix = "Name a key that ssh-keygen can sign with. The package is there, and not signed."
            raise PackageError(f"the package cannot be signed: {_last(answer)}", where=str(key), fix=fix)
        text = made.read_text(encoding="ascii")
    write_beside_and_rename(target, lambda file: file.write(text))
    return target


def check_signature(package: Path, trusted: Path | None = None) -> Signer:
    """Return the signer of a package.

    Args:
        package: the zip file, with its signature beside it.
        trusted: a file with public keys, one a line, or with allowed signers (ssh-keygen(1), ALLOWED SIGNERS). Without
            it, the signature is checked, but the owner of the key stays unknown.

    Raises:
        PackageError: there is no signature, it does not match this package, or it is not by a trusted signer.
        StorageError: a file cannot be read.
    """
    signature = signature_of(package)
    if not signature.is_file() or signature.stat().st_size > _LARGEST:
        problem = "the signature is not a file of a signature's size" if signature.exists() else "there is no signature"
        raise PackageError(problem, where=str(signature), fix=_GET_IT_AGAIN)
    answer = _ssh_keygen(["-Y", "check-novalidate", "-n", _NAMESPACE, "-s", str(signature)], package)
    made_by = _FINGERPRINT.search(answer.stdout)
    if answer.returncode or made_by is None:
        problem = f"the signature is not one of this package: {_last(answer)}"
        raise PackageError(problem, where=str(signature), fix=_GET_IT_AGAIN)
    key = f"{made_by[1]} {made_by[2]}"
    return Signer(key, _name(package, signature, trusted, key) if trusted else None)


def _name(package: Path, signature: Path, trusted: Path, key: str) -> str:
    """Return the owner of the key in the file of trusted signers."""
    with tempfile.TemporaryDirectory(prefix="robot-runner-signers-") as folder:
        signers = Path(folder, "allowed_signers")
        signers.write_text(_allowed_signers(trusted), encoding="utf-8")
        found = _ssh_keygen(["-Y", "find-principals", "-s", str(signature), "-f", str(signers)], package)
        name = next(iter(found.stdout.splitlines()), "")
        if found.returncode or not name:
            problem = f"the package was signed with the key {key}, which is none of those that are trusted"
            raise PackageError(problem, where=str(trusted), fix="Ask its authors for their key, over another way.")
        words = ["-Y", "verify", "-f", str(signers), "-I", name, "-n", _NAMESPACE, "-s", str(signature)]
        verified = _ssh_keygen(words, package)
    if verified.returncode:
        problem = f"the signature of {name} does not count: {_last(verified)}"
        raise PackageError(problem, where=str(trusted), fix="Look at what the file allows that key, and until when.")
    return name


def _allowed_signers(trusted: Path) -> str:
    """Return the lines of a file in the form of allowed signers; a public key's name is its comment."""
    try:
        lines = [line.strip() for line in trusted.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise storage_error(trusted, "read", error if isinstance(error, OSError) else OSError(str(error))) from error
    kept = []
    for number, line in enumerate(lines, start=1):
        if not line or line.startswith("#"):
            continue
        if line.startswith(_KEY_TYPES):
            kind, _, rest = line.partition(" ")
            key, _, comment = rest.strip().partition(" ")
            name = re.sub(r"[^\w.@+-]+", "_", comment) or f"line_{number}"
            kept.append(f'{name} namespaces="{_NAMESPACE}" {kind} {key}\n')
        else:
            kept.append(f"{line}\n")
    if not kept:
        fix = "Give a file with public keys, such as id_ed25519.pub, or with allowed signers."
        raise PackageError("the file has no keys", where=str(trusted), fix=fix)
    return "".join(kept)


def _ssh_keygen(words: Sequence[str], package: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run ssh-keygen with the package as its input, or on the terminal, where it may ask for a passphrase."""
    program = shutil.which("ssh-keygen")
    if program is None:
        fix = "Install OpenSSH's client, such as with: apt install openssh-client"
        raise PackageError("the program ssh-keygen is not installed", where="signature", fix=fix)
    asks = package is None and sys.stdin.isatty()
    try:
        with nullcontext() if asks else Path(package or os.devnull).open("rb") as file:
            return subprocess.run(  # noqa: S603 - words of our own, and paths that a user named
                [program, *words],
                stdin=file,
                stdout=subprocess.PIPE,
                stderr=None if asks else subprocess.PIPE,  # it asks for the passphrase there
                encoding="utf-8",
                errors="replace",
                timeout=_DEADLINE_S,
                check=False,
            )
    except subprocess.TimeoutExpired as error:
        problem = f"ssh-keygen did not end within {_DEADLINE_S:.0f} s"
        raise PackageError(problem, where="signature", fix="Sign with a key that asks for nothing.") from error
    except OSError as error:
        raise storage_error(Path(package or program), "read", error) from error


def _last(answer: subprocess.CompletedProcess[str]) -> str:
    lines = [line.strip() for line in (answer.stderr or answer.stdout or "").splitlines() if line.strip()]
    return lines[-1] if lines else f"ssh-keygen ended with exit code {answer.returncode}"
