"""A package's signature is OpenSSH's: made and checked by its own program, on both sides."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from robot_runner.core.errors import PackageError
from robot_runner.replication.signatures import check_signature, sign, signature_of

NAMESPACE = "robot-runner-package"

pytestmark = pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="OpenSSH's client is not installed")


def ssh_keygen(*words, stdin=None):
    return subprocess.run(["ssh-keygen", *map(str, words)], stdin=stdin, capture_output=True, text=True, check=True)


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    """Return a folder with the keys of Ada and of Eve."""
    folder = tmp_path_factory.mktemp("keys")
    for name in ("ada", "eve"):
        ssh_keygen("-q", "-t", "ed25519", "-N", "", "-C", f"{name}@lab.example", "-f", folder / name)
    return folder


@pytest.fixture
def package(packed, tmp_path):
    return shutil.copy(packed.path, tmp_path / "small.zip")


def test_what_is_signed_here_is_good_for_ssh_keygen(package, keys, tmp_path):
    signature = sign(package, keys / "ada")
    signers = tmp_path / "signers"
    signers.write_text(f"ada@lab.example {(keys / 'ada.pub').read_text()}", encoding="utf-8")
    with package.open("rb") as file:
        words = ["-Y", "verify", "-f", signers, "-I", "ada@lab.example", "-n", NAMESPACE, "-s", signature]
        assert "Good" in ssh_keygen(*words, stdin=file).stdout


def test_what_ssh_keygen_signs_is_good_here_for_keys_and_for_allowed_signers(package, keys, tmp_path):
    ssh_keygen("-Y", "sign", "-f", keys / "ada", "-n", NAMESPACE, package)
    public = (keys / "ada.pub").read_text(encoding="utf-8")
    assert check_signature(package).name is None
    signer = check_signature(package, keys / "ada.pub")
    assert signer.name == "ada@lab.example"
    assert signer.key == "ED25519 " + ssh_keygen("-lf", keys / "ada.pub").stdout.split()[1]
    both = tmp_path / "keys.txt"  # as a page with somebody's public keys has them: without comments
    both.write_text("\n".join(f"ssh-ed25519 {(keys / n).read_text().split()[1]}" for n in ("eve.pub", "ada.pub")))
    assert check_signature(package, both).name == "line_2"
    both.write_text(f"# who may\nlab-robot {public}", encoding="utf-8")
    assert check_signature(package, both).name == "lab-robot"


def test_nothing_else_counts(package, keys, tmp_path):
    def refusal(trusted=None):
        with pytest.raises(PackageError) as refused:
            check_signature(package, trusted)
        return refused.value.findings[0].problem

    assert "there is no signature" in refusal(keys / "ada.pub")
    signature = sign(package, keys / "eve")
    assert "which is none of those that are trusted" in refusal(keys / "ada.pub")
    limited = tmp_path / "limited"
    public = (keys / "eve.pub").read_text(encoding="utf-8")
    limited.write_text(f'eve valid-before="20200101" {public}', encoding="utf-8")
    assert "trusted" in refusal(limited) or "does not count" in refusal(limited)
    limited.write_text("# nobody\n", encoding="utf-8")
    assert "the file has no keys" in refusal(limited)
    signature.unlink()
    ssh_keygen("-Y", "sign", "-f", keys / "ada", "-n", "git", package)  # made for something else
    assert "not one of this package" in refusal()
    sign(package, keys / "ada")
    with package.open("r+b") as file:
        file.seek(-1, 2)
        last = file.read(1)
        file.seek(-1, 2)
        file.write(bytes([last[0] ^ 1]))
    assert "not one of this package" in refusal(keys / "ada.pub")
    signature_of(package).write_text("-----BEGIN SSH SIGNATURE-----\nU1NI\n-----END SSH SIGNATURE-----\n")
    assert "not one of this package" in refusal()
    signature_of(package).write_bytes(b"x" * 100_000)
    assert "not a file of a signature's size" in refusal()


@pytest.mark.long
def test_pack_signs_and_verify_asks_who(experiment, robot_runner, keys, tmp_path):
    shutil.copytree(experiment, tmp_path / "small")
    words = ["--no-wheels", "--no-hashes", "--raw", "none"]
    assert "there is no such key" in robot_runner("pack", "small", *words, "--sign", "nobody").err
    assert not (tmp_path / "small.zip").exists()
    answer = robot_runner("pack", "small", *words, "--sign", keys / "ada")
    assert answer.code == 0, answer.err
    assert "Signed   small.zip.sig" in answer.out
    assert "whose it is, only --signed-by tells" in robot_runner("verify", "small.zip").out
    assert "by ada@lab.example" in robot_runner("verify", "small.zip", "--signed-by", keys / "ada.pub").out
    assert robot_runner("verify", "small.zip", "--signed-by", keys / "ada.pub", "--json").json["signed_by"]
    refused = robot_runner("verify", "small.zip", "--signed-by", keys / "eve.pub")
    assert (refused.code, "none of those that are trusted" in refused.err) == (2, True)
    # Packed again with other contents, the old signature is not left to be found out by others.
    stale = robot_runner("pack", "small", *words, "--licence", "MIT")
    assert (stale.code, "not one of this package" in stale.err) == (2, True)
    assert robot_runner("verify", "small.zip").code == 2
    (tmp_path / "small.zip.sig").unlink()
    assert robot_runner("verify", "small.zip").code == 0
    missing = robot_runner("verify", "small.zip", "--signed-by", keys / "ada.pub")
    assert (missing.code, "there is no signature" in missing.err) == (2, True)
    assert robot_runner("verify", "small", "--signed-by", keys / "ada.pub").code == 2


@pytest.mark.long
def test_a_passphrase_is_asked_for_on_the_terminal(experiment, terminal, keys, tmp_path):
    ssh_keygen("-q", "-t", "ed25519", "-N", "correct horse", "-f", tmp_path / "locked")
    shutil.copytree(experiment, tmp_path / "small")
    words = ["--no-wheels", "--no-hashes", "--raw", "none", "--sign", str(tmp_path / "locked")]
    screen = terminal("pack", "small", *words)
    screen.wait_for("passphrase")
    screen.child.sendline("correct horse")
    assert screen.finish() == 0
    assert check_signature(tmp_path / "small.zip", tmp_path / "locked.pub").name
