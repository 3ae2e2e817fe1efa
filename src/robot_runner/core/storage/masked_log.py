"""Masking secrets of the environment in the log of a run.

What Python prints is masked as it is written. Programs of a run print to the file directly: that is masked when the run
has ended, before the log is moved into the run's folder.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from robot_runner.core.secret_names import REDACTED, forms_of, secrets_of_environment, without_environment_secrets
from robot_runner.core.storage.guarded_files import open_to_read, open_to_write

_BLOCK = 1 << 20


class MaskedText(io.TextIOWrapper):
    r"""A text stream into which no value of a variable such as `LAB_TOKEN` is written.

    Example:
        >>> import io, os
        >>> os.environ["LAB_TOKEN"] = "open-sesame"
        >>> stream = MaskedText(io.BytesIO(), encoding="utf-8", write_through=True)
        >>> print("connected with open-sesame", file=stream)
        >>> stream.buffer.getvalue()
        b'connected with REDACTED\n'
        >>> del os.environ["LAB_TOKEN"]
    """

    def write(self, text: str) -> int:
        """Write a text with secrets replaced; return the length of the original."""
        super().write(without_environment_secrets(text))
        return len(text)


def mask_log(path: Path, root: Path) -> None:
    """Mask secrets of the environment in a file; a file without any is not written.

    Raises:
        StorageError: it cannot be read or written.
    """
    forms = [form.encode("utf-8", "surrogateescape") for each in secrets_of_environment() for form in forms_of(each)]
    if not forms:
        return
    with open_to_read(path, root) as file:
        if not any(form in block for block in _lines(file) for form in forms):
            return
    with open_to_read(path, root) as source, open_to_write(path, root) as target:
        for block in _lines(source):
            for form in forms:
                block = block.replace(form, REDACTED.encode())  # noqa: PLW2901 - one after the other
            target.write(block)


def _lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield a file in blocks of whole lines; a line that is longer than a block is split."""
    while block := file.read(_BLOCK):
        yield block + file.readline(_BLOCK)
