"""Stands in for EnergiBridge: its options, its output and its endings, as its source (src/main.rs) has them.

The processor draws 10 W; its counter is about to begin at 0 again.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from pathlib import Path

parser = argparse.ArgumentParser()
parser.add_argument("-o", "--output")
parser.add_argument("-i", "--interval", type=int, default=200)
parser.add_argument("command", nargs="+")
arguments = parser.parse_args()
interrupted = []
signal.signal(signal.SIGINT, lambda *_: interrupted.append(True))

begun = time.time()
output = Path(arguments.output).open("w", encoding="ascii")  # noqa: SIM115 - for as long as the program lives
output.write("Delta,Time,CPU_USAGE_0,CPU_USAGE_1,DRAM_ENERGY (J),PACKAGE_ENERGY (J),TOTAL_MEMORY,USED_MEMORY\n")
child = subprocess.Popen(arguments.command)


def say_row() -> None:
    now = time.time()
    counter = (262_143.0 + 10.0 * (now - begun)) % 262_144.0
    output.write(f"{arguments.interval},{round(now * 1000)},30,50,{now - begun},{counter},8000000000,2000000000\n")
    output.flush()


exit_code = None
while exit_code is None:
    say_row()
    time.sleep(arguments.interval / 1000)
    if interrupted:
        child.kill()
        exit_code = 1
    else:
        exit_code = child.poll()
say_row()
sys.exit(exit_code)
