"""A command-line meter for tests: it says 5 W and 20 %, a row each 20 ms, until it is interrupted.

Its options have it fail in one way or another.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

parser = argparse.ArgumentParser()
parser.add_argument("--output")
parser.add_argument("--dies-after", type=int)
parser.add_argument("--deaf", action="store_true")
parser.add_argument("--silent", action="store_true")
parser.add_argument("--fails", action="store_true")
parser.add_argument("--leaves-child")
parser.add_argument("--mutters", action="store_true")
parser.add_argument("--watts", default="5.0")
parser.add_argument("--ahead", type=float, default=0.0)
arguments = parser.parse_args()

if arguments.fails:
    sys.stderr.write("no sensor was found\n")
    sys.exit(3)
if arguments.deaf:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
if arguments.leaves_child:
    child = subprocess.Popen(["sleep", "600"])
    Path(arguments.leaves_child).write_text(str(child.pid), encoding="ascii")

stream = Path(arguments.output).open("w", encoding="ascii") if arguments.output else sys.stdout  # noqa: SIM115
begun = time.time()
count = 0


def say(text: str) -> None:
    stream.write(text + "\n")
    stream.flush()


def say_row() -> None:
    now = time.time()
    say(f"{(now + arguments.ahead) * 1000:.3f},{arguments.watts},20,{5000 * (now - begun):.3f},{os.getpid()}")


try:
    if not arguments.silent:
        say("time_ms,watts,percent,energy_mJ,pid")
    while arguments.dies_after is None or count < arguments.dies_after:
        if not arguments.silent:
            say_row()
        if arguments.mutters and count == 2:
            say("meter: recalibrated")
        count += 1
        time.sleep(0.02)
    sys.stderr.write("the sensor was lost\n")
    sys.exit(4)
except KeyboardInterrupt:
    if not arguments.silent:
        say_row()
    sys.stderr.write("bye\n")
