"""How to replicate the experiment, and what to compare."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import Block, Code, Facts, Paragraph, Section, Tone

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.analysis.report.material import Material

__all__ = ["replication_section"]


def replication_section(material: Material) -> Section:
    """Return the section."""
    name = material.results.folder.name
    blocks: list[Block] = [Paragraph(_intro(material))]
    if material.manifest("config", "file"):
        blocks.append(Code("\n".join(_commands(material, name))))
        blocks.append(Paragraph(_order(material), Tone.NOTE))
    else:
        text = "The folder holds no config: these results were made elsewhere. Their authors know how."
        blocks.append(Paragraph(text, Tone.WARNING))
    blocks.append(Facts(tuple(_contents())))
    return Section("how-to-replicate", "How to replicate", tuple(blocks))


def _intro(material: Material) -> str:
    return (
        f"Everything that the experiment consists of is in its folder, {material.results.folder.name}. This executes "
        "its config again, the same runs in the same order, with what was set by hand then, and compares the results "
        "with these; state as the bound what difference would not matter."
    )


def _commands(material: Material, name: str) -> Iterator[str]:
    version = material.manifest("software", "robot_runner")
    pinned = f"=={version}" if version else ""
    robot = str(material.manifest("robot", default=""))
    extras = "analysis,sim" if robot.startswith("simulated") else "analysis"
    yield f"pip install {shlex.quote(f'robot-runner[{extras}]{pinned}')}"
    yield f"robot-runner replicate {shlex.quote(name)} --bound 5%"
    yield ""
    yield "# One file that others can check and replicate"
    yield f"pip install {shlex.quote(f'robot-runner[replication]{pinned}')}"
    yield f"robot-runner pack {shlex.quote(name)}"
    yield f"robot-runner replicate {shlex.quote(f'{name}.zip')} --bound 5%"


def _order(material: Material) -> str:
    seed = material.results.seed
    if seed is None:
        return "The order of the runs comes from no recorded seed: it is in the run table, and is taken from there."
    if material.manifest("seed_is_given"):
        return f"The config gives seed {seed}: the order of the runs will be the same."
    return f"The order was drawn (seed {seed}); replicating takes the same seed, so that the order will be the same."


def _contents() -> Iterator[tuple[str, str]]:
    yield (
        "run_table.csv",
        "all runs with their treatments and measures; run_table.schema.json says what each column means",
    )
    yield "runs/", "the raw measures and the log of each run"
    yield "config/", "the config and the local modules that it imports, as executed"
    yield "manifest.json", "host, versions, seed, and what was set by hand"
    yield "journal.jsonl", "everything that happened, in order"
