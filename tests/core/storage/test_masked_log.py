"""What the environment keeps secret does not stay in a run's log, whoever printed it."""

from __future__ import annotations

import io

from robot_runner.core.storage.masked_log import MaskedText, mask_log


def test_a_print_is_hidden_as_it_is_written(monkeypatch):
    monkeypatch.setenv("LAB_TOKEN", "open-sesame")
    stream = MaskedText(io.BytesIO(), encoding="utf-8", errors="backslashreplace", line_buffering=True)
    print("connected with open-sesame", "\udc80", file=stream)
    assert stream.buffer.getvalue() == b"connected with REDACTED \\udc80\n"


def test_a_log_is_cleaned_and_keeps_its_permissions(monkeypatch, tmp_path):
    log = tmp_path / "log.txt"
    line = b"x" * 99 + b"\n"
    log.write_bytes(line * 10485 + b"open-sesame at the end of the first MiB\n" + line * 3 + b"\xff open-sesame")
    log.chmod(0o600)
    before = log.read_bytes()
    mask_log(log, tmp_path)
    assert log.read_bytes() == before  # nothing is secret yet
    monkeypatch.setenv("LAB_TOKEN", "open-sesame")
    mask_log(log, tmp_path)
    assert log.read_bytes() == before.replace(b"open-sesame", b"REDACTED")
    assert log.stat().st_mode & 0o077 == 0
    assert [path.name for path in tmp_path.iterdir()] == ["log.txt"]
