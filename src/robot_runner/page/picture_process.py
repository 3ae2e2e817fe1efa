"""The process that renders pictures of a robot: poses on standard input, pictures on standard output.

It is separate from the server, as a graphics library may block, leak or crash.
"""

from __future__ import annotations

import json
import os
import struct
import sys

from robot_runner.core.entry_points import named_entry_point

#: Width and height, pixels: enough for a phone, rendered in 20 ms without a graphics card.
SIZE = (480, 360)
#: The header of each answer: its length, and whether it is a picture (1) or the reason why there is none (0).
HEAD = struct.Struct(">IB")


def main(kind: str) -> int:
    """Render until standard input ends."""
    os.nice(10)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # graphics libraries may print to standard output

    def answer(data: bytes, *, is_picture: bool) -> None:
        answers.write(HEAD.pack(len(data), is_picture) + data)
        answers.flush()

    point = named_entry_point("pictures", kind)
    try:
        picture = point.load()(*SIZE) if point is not None else None
    except Exception as error:  # noqa: BLE001 - each graphics library fails in its own way
        answer(f"{type(error).__name__}: {error}".encode(), is_picture=False)
        return 1
    if picture is None:
        answer(b"there are no pictures of this kind of robot", is_picture=False)
        return 1
    for line in sys.stdin:
        try:
            answer(picture.png(*map(float, json.loads(line))), is_picture=True)
        except Exception as error:  # noqa: BLE001 - as above
            answer(f"{type(error).__name__}: {error}".encode(), is_picture=False)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
