"""The log of a run without what the environment keeps secret: hidden as it is printed, and once more when it is kept.

What Python prints is hidden as it is written. What a program that a run started prints goes to the file by itself: it
is hidden when the run has ended, before the log gets its name.
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
        """Write a text, secrets replaced; return how long it was."""
        super().write(without_environment_secrets(text))
        return len(text)


def mask_log(path: Path, root: Path) -> None:
    """Replace in a file what the environment keeps secret; a file without any stays as it is.

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
    """Yield a file in blocks of whole lines, as far as lines are not longer than a block."""
    while block := file.read(_BLOCK):
        yield block + file.readline(_BLOCK)
