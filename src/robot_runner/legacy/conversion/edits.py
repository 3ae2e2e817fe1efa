"""Changes to the text of a Python file, each at the place of a node of its syntax tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import ast

__all__ = ["Edits"]


@dataclass(frozen=True, slots=True, order=True)
class _Edit:
    start: int
    end: int
    text: str


class Edits:
    """Gathers changes and applies them all at once; a change inside a part that is replaced as a whole is dropped.

    Example:
        >>> import ast
        >>> tree = ast.parse("a + b  # kept")
        >>> edits = Edits("a + b  # kept")
        >>> edits.replace(tree.body[0].value.right, "c")
        >>> edits.applied()
        'a + c  # kept'
    """

    def __init__(self, text: str) -> None:
        self._bytes = text.encode()
        starts = [0]
        for line in self._bytes.splitlines(keepends=True):
            starts.append(starts[-1] + len(line))
        self._line_starts = starts
        self._edits: list[_Edit] = []

    def replace(self, node: ast.AST, text: str) -> None:
        """Put `text` in the place of a node."""
        self._edits.append(_Edit(self.start_of(node), self.end_of(node), text))

    def replace_span(self, start: int, end: int, text: str) -> None:
        """Put `text` in the place of some bytes."""
        self._edits.append(_Edit(start, end, text))

    def insert(self, position: int, text: str) -> None:
        """Put `text` before the byte at `position`."""
        self._edits.append(_Edit(position, position, text))

    def remove_paragraph(self, first: int, last: int) -> None:
        """Remove whole lines, and the blank one after them."""
        following = self._bytes[self._line_starts[last] :].partition(b"\n")[0]
        self.remove_lines(first, last if following.strip() else min(last + 1, len(self._line_starts) - 1))

    def remove_lines(self, first: int, last: int) -> None:
        """Remove whole lines, counted from 1."""
        self._edits.append(_Edit(self._line_starts[first - 1], self._line_starts[last], ""))

    def source(self, node: ast.AST) -> str:
        """Return the text of a node as it was."""
        return self._bytes[self.start_of(node) : self.end_of(node)].decode()

    def edited(self, node: ast.AST) -> str:
        """Return the text of a node with the changes so far that lie inside it."""
        start, end = self.start_of(node), self.end_of(node)
        inside = [edit for edit in self._edits if start <= edit.start and edit.end <= end]
        return _applied(self._bytes[start:end], [_Edit(e.start - start, e.end - start, e.text) for e in inside])

    def start_of(self, node: ast.AST) -> int:
        """Return where a node begins, in bytes; a class or function begins with its first decorator."""
        first = min([node, *getattr(node, "decorator_list", [])], key=lambda each: each.lineno)
        return self._position(first.lineno, first.col_offset) - (first is not node)

    def end_of(self, node: ast.AST) -> int:
        """Return where a node ends, in bytes."""
        return self._position(node.end_lineno, node.end_col_offset)  # type: ignore[attr-defined]

    def line_start(self, line: int) -> int:
        """Return where a line begins, in bytes; lines are counted from 1."""
        return self._line_starts[min(line, len(self._line_starts)) - 1]

    def find(self, text: str, after: int) -> int:
        """Return where `text` stands first after a position, in bytes."""
        return self._bytes.index(text.encode(), after)

    def applied(self) -> str:
        """Return the text with all changes."""
        return _applied(self._bytes, self._edits)

    def _position(self, line: int, column: int) -> int:
        return self._line_starts[line - 1] + column


def _applied(text: bytes, edits: list[_Edit]) -> str:
    # What is put before a place comes first, then the widest change there: it stands for those inside it.
    ordered = sorted(dict.fromkeys(edits), key=lambda edit: (edit.start, edit.end > edit.start, -edit.end))
    pieces, position = [], 0
    for edit in ordered:
        if edit.start < position:
            continue
        pieces += [text[position : edit.start], edit.text.encode()]
        position = edit.end
    return b"".join([*pieces, text[position:]]).decode()
