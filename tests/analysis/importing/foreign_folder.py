"""Results folders in the shapes that earlier tools and people make."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["EARLIER_TABLE", "make_earlier_folder", "write"]

#: As the earlier tools write it: their columns, lines that end in CR LF, a blank for a missing value.
EARLIER_TABLE = (
    "__run_id,__done,task,offloaded,repetition,duration_s,avg_cpu,energy_J\r\n"
    "run_0,DONE,video,true,1,2.0,20.0,15.0\r\n"
    "run_1,DONE,network,false,1,2.0,10.0,16.0\r\n"
    "run_2,DONE,video,false,2,2.0,20.0,30.0\r\n"
    "run_3,TODO,network,true,2, , , \r\n"
)


def write(path: Path, text: str, encoding: str = "utf-8") -> Path:
    """Write a file, and the folders that it needs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode(encoding))
    return path


def make_earlier_folder(root: Path) -> Path:
    """Make a results folder of the earlier tools: power in mW and CPU at moments without a time zone."""
    write(root / "run_table.csv", EARLIER_TABLE)
    for number, watts in enumerate((7.5, 8.0, 12.0)):
        milliwatts = watts * 1000
        power = "".join(f"2021-06-25 14:3{number}:0{second}.500,{milliwatts}\n" for second in range(3))
        write(root / f"run_{number}" / "power.csv", f"timestamp,power_mW\n{power}")
        cpu = "".join(f"2021-06-25 14:3{number}:0{second}.000,{share}\n" for second, share in enumerate((10, 30)))
        write(root / f"run_{number}" / "resources.csv", f"timestamp,cpu\n{cpu}")
        write(root / f"run_{number}" / "notes.csv", "who,what\nme,nothing\n")
    return root
