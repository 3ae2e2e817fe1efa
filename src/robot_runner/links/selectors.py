"""Which processes to look at: by number, by name, or by the ROS node that they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.errors import LinkError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["KINDS", "checked_words", "process_selector"]

#: What stands before the colon of a selector.
KINDS = ("pid", "name", "node")


def process_selector(process: str | int) -> str:
    """Return the selector of a process: a number is its pid, a text its name unless it says `pid:` or `node:` itself.

    Raises:
        LinkError: it is neither a number nor a text, is empty, or begins with another word and a colon.

    Example:
        >>> [process_selector(process) for process in (4711, "talker", "node:/talker")]
        ['pid:4711', 'name:talker', 'node:/talker']
    """
    if isinstance(process, bool) or not isinstance(process, int | str):
        raise LinkError(
            f"{process!r} selects no process", where="processes", fix="Give a name, a number, or node:/name."
        )
    if isinstance(process, int):
        return f"pid:{process}"
    text = process
    kind, colon, value = text.partition(":")
    if not colon:
        kind, value = "name", text
    if kind not in KINDS:
        raise LinkError(f"{text!r} selects no process", where="processes", fix=did_you_mean(kind, KINDS))
    if not value.strip() or (kind == "pid" and not value.isdigit()):
        raise LinkError(f"{text!r} selects no process", where="processes", fix="Give a name, a number, or node:/name.")
    return f"{kind}:{value}"


def checked_words(words: Iterable[str]) -> list[str]:
    """Return words that can stand on one line with tabs between.

    Raises:
        LinkError: one of them holds a tab or the end of a line, or is empty.
    """
    listed = list(words)
    for word in listed:
        if not word or any(character in word for character in "\t\n\0"):
            raise LinkError(f"{word!r} cannot be sent", where="host", fix="Leave out tabs and ends of lines.")
    return listed
