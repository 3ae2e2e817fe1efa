"""The first lines of a file that is a program, executed by the Python of the tests."""

from __future__ import annotations

import sys


def first_lines(options: str = "", *, python: object = sys.executable) -> str:
    """Return them: a shell replaces itself by Python, to which they are a text.

    After `#!` alone, the path of Python may have no space, and 127 characters at most.
    """
    return f"#!/bin/sh\n'''exec' \"{python}\" {options} \"$0\" \"$@\"\n' '''\n"
