"""Tables in the shapes that public run tables have: what each column is, and where that is asked.

The tables are made here; their shapes are those of published studies, whose data cannot be kept with the project.
"""

from __future__ import annotations

from itertools import product

import pytest
from tests.analysis.importing.foreign_folder import write

from robot_runner.analysis.importing.column_evidence import Confidence
from robot_runner.analysis.importing.column_roles import roles_of
from robot_runner.analysis.importing.description import ImportDescription
from robot_runner.analysis.importing.foreign_table import read_foreign_table
from robot_runner.core.errors import AnalysisError

TASK = {"task": ["video", "audio", "idle"]}
SPEED = {"speed": ["1", "2"]}
PLANNER = {"planner": ["a", "b"]}
MODES = TASK | {"mode": ["a", "b"]}
MAPS = {"map": ["maze", "hall"]}
AGENTS = {"agents": ["1", "2", "3", "4", "5"]}
VERSIONS = [("2023.1.1", "rtx"), ("2024.1.0", "rtx"), ("2024.1.0", "a100")]
SIGNS = [*product((-1, 1), repeat=3)]
OUTCOMES = {"rep": "{rep}", "ok": "{truth}", "docked": "{other}"}


def made(heading, factors, repetitions=3, **cells):
    """Return a table with a row for each repetition of each combination.

    In cells, `n` counts rows, `c` combinations and `r` repetitions, all from 0; `x` differs in every row, `q` is one of
    three numbers, unevenly; what is not given is `x`.
    """
    lines = [heading]
    for n, (r, (c, treatments)) in enumerate(product(range(repetitions), enumerate(product(*factors.values())))):
        known = dict(zip(factors, treatments, strict=True))
        values = {"n": n, "c": c, "r": r, "x": 10 + (n * 37 % 101) / 7, "q": (n % 7 == 0) + (n % 11 == 0), **known}
        values |= {"one": n + 1, "rep": r + 1, "even": n % 2}
        values |= {"likert": n * 37 % 11 % 5 + 1}
        values |= {"truth": str(n * 37 % 11 < 6).lower(), "other": str(n * 23 % 13 < 7).lower()}
        row = [known.get(name) or str(cells.get(name, "{x:.4f}")).format(**values) for name in heading.split(",")]
        lines.append(",".join(row))
    return "\n".join(lines) + "\n"


def summary(roles):
    """Return roles as they are written below: id, status, repetition, block, factors, measures, others, unsure."""
    parts = {
        "id": roles.run_id,
        "done": roles.status,
        "rep": "@" if roles.repetition_in_run_id else roles.repetition,
        "block": roles.block,
        "F": "+".join(roles.factors),
        "M": "+".join(roles.measures),
        "X": "+".join(roles.extras),
        "?": "+".join(guess.column for guess in roles.unsure),
    }
    return " ".join(f"{key}={value}" for key, value in parts.items() if value)


IDS = {"__run_id": "run_{c}_repetition_{r}", "__done": "DONE"}
PLAIN = {"__run_id": "run_{n}", "__done": "DONE"}

COUNTED = "id=__run_id done=__done rep={} F=task M=energy"

SHAPES = {
    # Names and numbers of rows before the factors.
    "pandas' index": (made("Unnamed: 0,task,energy", TASK, **{"Unnamed: 0": "{n}"}), "F=task M=energy"),
    "R's index": (made('"",task,energy', TASK, **{'""': "{one}"}), "F=task M=energy"),
    "an index shuffled": (made(",task,energy", TASK, **{"": "{x:.0f}"}), "F=task M=energy X=column_1"),
    "an id": (made("id,task,energy", TASK, id="{one}"), "id=id F=task M=energy"),
    "an id beside the run's": (
        made("id,__run_id,__done,task,energy", TASK, id="{n}", **IDS),
        "id=__run_id done=__done rep=@ F=task M=energy X=id",
    ),
    "an index beside the run's": (
        made("Unnamed: 0,__run_id,__done,task,energy", TASK, **{"Unnamed: 0": "{n}"}, **IDS),
        "id=__run_id done=__done rep=@ F=task M=energy",
    ),
    "No.": (made("No.,task,energy", TASK, **{"No.": "{one}"}), "id=No. F=task M=energy"),
    "an entry's id": (
        made("entry_id,run_id,task,energy", TASK, entry_id="{n}", run_id="run_{n}"),
        "id=run_id F=task M=energy X=entry_id",
    ),
    "ids that are empty": (
        made(
            "__run_id,__done,run_number,task,energy", TASK, __run_id="", __done="False", run_number="{one}", energy=""
        ),
        "id=run_number done=__done F=task M=energy X=__run_id",
    ),
    # What counts repetitions.
    "repetitions in ids": (
        made("__run_id,__done,task,energy", TASK, **IDS),
        "id=__run_id done=__done rep=@ F=task M=energy",
    ),
    "rep in ids": (made("run_id,task,energy", TASK, run_id="job_{c}_rep{r}"), "id=run_id rep=@ F=task M=energy"),
    "ids of one repetition": (
        made(
            "__run_id,__done,task,run_number,energy",
            TASK,
            __run_id="run_{n}_repetition_0",
            __done="DONE",
            run_number="{rep}",
        ),
        "id=__run_id done=__done rep=run_number F=task M=energy",
    ),
    "repetition": (
        made("__run_id,__done,task,repetition,energy", TASK, repetition="{rep}", **PLAIN),
        COUNTED.format("repetition"),
    ),
    "rep": (made("__run_id,__done,task,rep,energy", TASK, rep="{rep}", **PLAIN), COUNTED.format("rep")),
    "Trial": (made("__run_id,__done,task,Trial,energy", TASK, Trial="{r}", **PLAIN), COUNTED.format("Trial")),
    "round": (made("__run_id,__done,task,round,energy", TASK, round="{rep}", **PLAIN), COUNTED.format("round")),
    "iteration": (
        made("__run_id,__done,task,iteration,energy", TASK, iteration="{rep}", **PLAIN),
        COUNTED.format("iteration"),
    ),
    "repetition_id": (
        made("__run_id,__done,task,repetition_id,energy", TASK, repetition_id="{r}", **PLAIN),
        COUNTED.format("repetition_id"),
    ),
    "run_number in words": (
        made("__run_id,__done,run_number,task,energy", TASK, run_number="r{rep}", **PLAIN),
        COUNTED.format("run_number"),
    ),
    "run": (made("__run_id,__done,run,task,energy", TASK, run="{rep}", **PLAIN), COUNTED.format("run")),
    "experiment after measures": (
        made("__run_id,__done,task,energy,experiment", TASK, experiment="{rep}", **PLAIN),
        COUNTED.format("experiment"),
    ),
    "a file for each repetition": (
        made("__run_id,__done,task,energy,Repetition", TASK, Repetition="cat_repeat{rep}.csv", **PLAIN),
        COUNTED.format("Repetition"),
    ),
    "run without other ids": (made("run,task,energy", TASK, run="{rep}"), "rep=run F=task M=energy"),
    "runs counted across combinations": (made("run,task,energy", TASK, run="{n}"), "id=run F=task M=energy"),
    "the run's number alone": (
        made("__run_id,__done,run,energy", {"": [""]}, 6, run="{n}", **PLAIN),
        "id=__run_id done=__done rep=run M=energy",
    ),
    "run names the combination": (
        made("__run_id,__done,task,speed,run,rep,energy", TASK | SPEED, run="{c}", rep="{rep}", **PLAIN),
        "id=__run_id done=__done rep=rep F=task+speed M=energy X=run",
    ),
    "iteration is a factor": (
        made("__run_id,__done,task,iteration,energy", TASK | {"iteration": ["1", "2", "3"]}, **IDS),
        "id=__run_id done=__done rep=@ F=task+iteration M=energy",
    ),
    "iterations are a factor": (
        made("__run_id,__done,task,iterations,energy", TASK | {"iterations": ["100", "1000"]}, **IDS),
        "id=__run_id done=__done rep=@ F=task+iterations M=energy",
    ),
    "runs that share a repetition": (
        made("task,Trial,energy", TASK, 4, Trial="{even}"),
        "rep=Trial F=task M=energy ?=Trial",
    ),
    "sets that may be repetitions": (
        made("task,energy,results", TASK, 4, results="set_{rep}"),
        "F=task+results M=energy ?=results",
    ),
    "how many trials each row sums up": (
        "condition,trials,success_rate\nclean,50,0.9\nknown,50,0.85\nunseen,40,0.8\nsimilar,30,0.7\n",
        "F=condition M=trials+success_rate",
    ),
    # Measures that look like factors.
    "a nearly constant measure": (
        made("__run_id,__done,task,swap,energy", TASK, 4, swap="{q}", **IDS),
        "id=__run_id done=__done rep=@ F=task M=swap+energy",
    ),
    "a nearly constant measure, without repetitions": (
        made("task,energy,exit_code", TASK, 8, exit_code="{q}"),
        "F=task M=energy+exit_code",
    ),
    "a constant measure": (
        made("__run_id,__done,task,energy,total_memory", TASK, total_memory="4096", **IDS),
        "id=__run_id done=__done rep=@ F=task M=energy+total_memory",
    ),
    "whether it worked": (
        made("__run_id,__done,task,energy,success", TASK, 5, success="true", **IDS),
        "id=__run_id done=__done rep=@ F=task M=energy+success",
    ),
    "whether it worked, before the measures and without repetitions": (
        made("task,speed,success,energy", TASK | SPEED, 4, success="{truth}"),
        "F=task+speed+success M=energy ?=success",
    ),
    "whether it crashed, as 0 and 1, before the measures": (
        made("task,has_crashed,energy", TASK, 8, has_crashed="{even}"),
        "F=task+has_crashed M=energy ?=has_crashed",
    ),
    "what is on, before the measures": (
        made("task,gpu,energy", TASK, 8, gpu="{truth}"),
        "F=task+gpu M=energy",
    ),
    "whether it was reached, between the measures and about every second time": (
        made("task,mode,rep,energy,ok,docked,way_m", MODES, 5, **OUTCOMES),
        "rep=rep F=task+mode M=energy+ok+docked+way_m",
    ),
    "whether it was reached, with nothing that counts repetitions": (
        made("task,mode,energy,ok", MODES, 5, **OUTCOMES),
        "F=task+mode+ok M=energy ?=ok",
    ),
    "whether it was reached, before the measures": (
        made("task,mode,rep,ok,energy", MODES, 5, **OUTCOMES),
        "rep=rep F=task+mode+ok M=energy ?=ok",
    ),
    "whether it was reached, in words": (
        made("task,mode,rep,energy,ok", MODES, 5, **OUTCOMES).replace("true", "yes").replace("false", "No"),
        "rep=rep F=task+mode M=energy+ok",
    ),
    "how it ended, in words": (
        made("task,mode,rep,energy,end", MODES, 5, rep="{rep}", end="{truth}")
        .replace("true", "ok")
        .replace("false", "late"),
        "rep=rep F=task+mode M=energy X=end ?=end",
    ),
    "a factor of words behind the measures": (
        made("rep,energy,task,cached", TASK | {"cached": ["yes", "no"]}, 5, rep="{rep}"),
        "rep=rep F=task+cached M=energy ?=cached",
    ),
    "a factor of truth values, and an outcome": (
        made("task,cached,rep,energy,ok", TASK | {"cached": ["true", "false"]}, 5, **OUTCOMES),
        "rep=rep F=task+cached M=energy+ok",
    ),
    "few numbers, unevenly, with no word for it": (
        made("level,energy", {}, 12, level="{q}"),
        "F=level M=energy ?=level",
    ),
    "problems that are numbered": (
        made("problem_id,task,energy", {"problem_id": [*map(str, range(20))]} | TASK, 1),
        "F=problem_id+task M=energy ?=problem_id",
    ),
    "whether it was reached, as numbers": (
        made("task,steps,reached", TASK, 8, steps="{q}", reached="{even}"),
        "F=task+steps+reached ?=steps+reached",
    ),
    "many steps, and whether it was reached": (
        made("task,steps,reached", TASK, 8, steps="{x:.0f}", reached="{q}"),
        "F=task M=steps+reached",
    ),
    # Factors that look like measures, and that come late.
    "numbers with a unit": (
        made("__run_id,__done,speed_m_s,energy", {"speed_m_s": ["0.1", "0.2"]}, 4, **PLAIN),
        "id=__run_id done=__done F=speed_m_s M=energy",
    ),
    "a limit of the CPU, still to do": (
        made(
            "__run_id,__done,cpu_limit,pin,avg_cpu",
            {"cpu_limit": ["20", "50"], "pin": ["True", "False"]},
            1,
            __run_id="run_{n}",
            __done="TODO",
            avg_cpu="",
        ),
        "id=__run_id done=__done F=cpu_limit+pin M=avg_cpu",
    ),
    "a measure without repetitions beside one that nobody measured": (
        made("__run_id,__done,task,speed,memory,power,cpu", TASK | SPEED, 1, memory="46{x:.0f}", power="", **PLAIN),
        "id=__run_id done=__done F=task+speed M=memory+power+cpu",
    ),
    "factors after measures": (
        made("energy,time_s,task,mode", TASK | {"mode": ["a", "b"]}),
        "F=task+mode M=energy+time_s",
    ),
    "numbers after measures": (made("energy,threads", {"threads": ["2", "4", "8"]}, 4), "F=threads M=energy ?=threads"),
    "one run for each treatment": (made("app,energy", {"app": ["maps", "mail", "chat", "news"]}, 1), "F=app M=energy"),
    # What follows from factors.
    "a name for the combination": (
        made("name,repetition,energy,task,mode", TASK | {"mode": ["a", "b"]}, name="{task}_{mode}", repetition="{rep}"),
        "rep=repetition F=task+mode M=energy X=name",
    ),
    "a second name": (
        made("task_id,task,energy", TASK, 4, task_id="t{c}"),
        "F=task M=energy X=task_id",
    ),
    "the kind of a task": (
        made("task,kind,energy", {"task": ["sort", "scan", "zip", "tar"]}, 4, kind="k{even}"),
        "F=task M=energy X=kind",
    ),
    "subjects that belong to treatments": (
        made("subject,cached,energy", {"subject": ["a", "b", "c", "d"]}, 4, cached="{even}"),
        "F=cached M=energy X=subject ?=subject",
    ),
    # Text.
    "moments": (
        made("__run_id,__done,task,started,energy", TASK, started="2021-06-25 14:3{r}:0{c}", **IDS),
        "id=__run_id done=__done rep=@ F=task M=energy X=started",
    ),
    "moments since 1970": (
        made("__run_id,__done,task,start_time,energy", TASK, start_time="15711771{n:02}.5", **IDS),
        "id=__run_id done=__done rep=@ F=task M=energy X=start_time",
    ),
    "moments as a spreadsheet writes them": (
        made("Timestamp,device,availability", {"device": ["a"]}, 9, Timestamp="12/22/2024 18:0{q}"),
        "F=device M=availability X=Timestamp",
    ),
    "moments of a day with a month in words": (
        made("__run_id,__done,task,started,energy", TASK, started="22 Dec 2024 18:0{r}", **PLAIN),
        "id=__run_id done=__done F=task M=energy X=started",
    ),
    "a path": (
        made("__run_id,__done,task,energy,log_path", TASK, log_path="/data/{n}.log", **IDS),
        "id=__run_id done=__done rep=@ F=task M=energy X=log_path",
    ),
    "text that some lack": (
        made("__run_id,__done,task,energy,status", TASK, status="ok", **IDS).replace(",ok", ",", 2),
        "id=__run_id done=__done rep=@ F=task M=energy X=status",
    ),
    "a version": (
        made("__run_id,__done,package,task,energy", TASK, package="nav2", **IDS),
        "id=__run_id done=__done rep=@ F=package+task M=energy",
    ),
    # Blocks.
    "three robots": (
        made("robot,task,repetition,energy", {"robot": ["tb_1", "tb_2", "tb_3"]} | TASK, repetition="{rep}"),
        "rep=repetition block=robot F=task M=energy",
    ),
    "days": (
        made("day,task,energy", {"day": ["2021-06-01", "2021-06-02", "2021-06-03"]} | TASK, 2),
        "block=day F=task M=energy",
    ),
    "robots of two kinds": (
        made("robot,task,energy", {"robot": ["husky", "turtlebot"]} | TASK, 3),
        "F=robot+task M=energy",
    ),
    "robots that each have one task": (
        made("robot,task,energy", {"robot": ["r1", "r2", "r3", "r4"]}, 4, task="t{even}"),
        "F=task M=energy X=robot ?=robot",
    ),
    "subjects": (made("subject,task,energy", {"subject": ["s1", "s2", "s3"]} | TASK, 2), "F=subject+task M=energy"),
    "blocks by their name": (
        made("Block,task,energy", {"Block": ["I", "II", "III", "kitchen"]} | TASK, 1),
        "block=Block F=task M=energy",
    ),
    "two blocks": (made("block,task,energy", {"block": ["1", "2"]} | TASK, 2), "block=block F=task M=energy"),
    "blocks without some combinations": (
        "block,task,energy\n"
        + "".join(f"{n // 4},{('video', 'audio')[n % 2 if n < 20 else 0]},{n * 37 % 101 / 7:.4f}\n" for n in range(24)),
        "block=block F=task M=energy",
    ),
    # Numbers of rows, whatever the language of the heading.
    "rows that are counted": (
        made("Versuch,task,speed [m/s],energy", TASK | {"speed [m/s]": ["0.1", "0.2"]}, Versuch="{one}"),
        "id=Versuch F=task+speed [m/s] M=energy",
    ),
    "rows that are counted by repetitions": (
        made("task,trial,energy", {"task": ["video"]}, 8, trial="{rep}"),
        "rep=trial F=task M=energy",
    ),
    "rows that are counted, beside run ids": (
        made("__run_id,__done,Lauf,task,energy", TASK, Lauf="{n}", **IDS),
        "id=__run_id done=__done rep=@ F=task M=energy X=Lauf ?=Lauf",
    ),
    # Numbers that grow from row to row are not, where they may be measured or varied.
    "laps that grow, last": (made("planner,energy_J,laps", PLANNER, 3, laps="{one}"), "F=planner M=energy_J+laps"),
    "laps that grow, alone": (made("planner,laps", PLANNER, 3, laps="{one}"), "F=planner M=laps"),
    "laps that grow, first": (made("laps,planner", PLANNER, 3, laps="{one}"), "F=planner M=laps"),
    "laps that grow, beside run ids": (
        made("__run_id,__done,planner,laps", PLANNER, 3, laps="{one}", **IDS),
        "id=__run_id done=__done rep=@ F=planner M=laps",
    ),
    "goals that grow, beside names of runs": (
        made("run_id,planner,goals", PLANNER, 3, run_id="{one}", goals="{one}"),
        "id=run_id F=planner M=goals",
    ),
    "robots that grow, with one run each": (
        "robots,time_s,energy_J\n" + "".join(f"{n},{n * 37 % 11 / 7:.3f},{n * 53 % 13 / 7:.3f}\n" for n in range(1, 9)),
        "M=robots+time_s+energy_J",
    ),
    "obstacles that grow, with one run each": (
        "obstacles,energy\n" + "".join(f"{n},{n * 37 % 11 / 7:.3f}\n" for n in range(1, 7)),
        "M=obstacles+energy",
    ),
    "a measure that grows by one": (made("task,depth_m,energy", TASK, depth_m="{one}"), "F=task M=depth_m+energy"),
    "outcomes that are equally frequent": (
        "planner,energy_J,success\na,1.5,1\na,2.5,0\nb,3.5,0\nb,4.5,1\n",
        "F=planner M=energy_J+success",
    ),
    "collisions that are equally frequent": (
        "planner,energy_J,collisions\na,1.5,1\na,2.5,0\nb,3.5,0\nb,4.5,1\n",
        "F=planner M=energy_J+collisions",
    ),
    "outcomes without factors": (
        "energy_J,success\n" + "".join(f"{n * 37 % 11 / 7:.3f},{n % 2}\n" for n in range(10)),
        "M=energy_J+success",
    ),
    "a factor in a unit, after the measures": (
        made("energy,speed [m/s],task", {"speed [m/s]": ["0.1", "0.2"]} | TASK),
        "F=speed [m/s]+task M=energy ?=speed [m/s]",
    ),
    # Measured numbers that are as evenly distributed as planned ones, by chance or as they were rounded.
    "a duration of two values, after a measure, in four rows": (
        "planner,energy_J,duration_s\na,1.5,60\na,1.7,61\nb,2.5,60\nb,2.2,61\n",
        "F=planner M=energy_J+duration_s",
    ),
    "a duration of two values, before a measure, in six rows": (
        "planner,duration_s,energy_J\n"
        + "".join(f"{'abc'[n // 2]},{60 + n % 2},{n * 37 % 11 / 7:.3f}\n" for n in range(6)),
        "F=planner+duration_s M=energy_J ?=duration_s",
    ),
    "times of two values, beside two factors that tell all runs apart": (
        "algo,map,time_ms,path_m\n"
        + "".join(f"{'abc'[n // 2]},{'xy'[n % 2]},{10 + 2 * (n % 3 > 0 < n)},{n * 37 % 11}.{n}\n" for n in range(6)),
        "F=algo+map+time_ms M=path_m ?=time_ms",
    ),
    "answers of a questionnaire, before a measure": (
        made("voice,comfort,wait_s", {"voice": ["calm", "loud"]}, 15, comfort="{likert}"),
        "F=voice+comfort M=wait_s ?=comfort",
    ),
    "treatments of a fraction, each evenly with each other": (
        "A,B,C,D,y\n"
        + "".join(f"{a},{b},{c},{a * b * c},{(n * 37 + 5) % 101 / 7:.3f}\n" for n, (a, b, c) in enumerate(SIGNS)),
        "F=A+B+C+D M=y",
    ),
    "speeds in percent, more than a dozen": (
        made("speed_pct,power_W", {"speed_pct": [*map(str, range(5, 105, 5))]}, 2),
        "F=speed_pct M=power_W ?=speed_pct",
    ),
    "paths that a planner finds again in each repetition": (
        made("planner,map,rep,path_m,time_s,nodes", PLANNER | MAPS, 4, rep="{rep}", path_m="{c}.25", nodes="9{c}7"),
        "rep=rep F=planner+map M=path_m+time_s+nodes",
    ),
    "loops that a benchmark counted, beside a column that it left empty": (
        made("name,loops,time_ns,label", {"name": ["a", "b"]}, 5, loops="9{x:.0f}", label=""),
        "F=name M=loops+time_ns+label",
    ),
    # Planned numbers that are as uneven as measured ones, or have the heading of a measure.
    "a decimal setting of one letter": (
        made("n,task,energy", TASK | {"n": ["0.5", "1.5"]}),
        "F=n+task M=energy",
    ),
    "a setting in four rows": (
        "planner,power_limit_W,fps\na,15,1.5\na,30,1.7\nb,15,2.5\nb,30,2.2\n",
        "F=planner+power_limit_W M=fps",
    ),
    "close settings in four rows": (
        "propeller,voltage_V,thrust_N\na,11,1.5\na,12,1.7\nb,11,2.5\nb,12,2.2\n",
        "F=propeller+voltage_V M=thrust_N",
    ),
    "agents of which a planner does not manage the most": (
        "\n".join(row for row in made("planner,agents,time_s", PLANNER | AGENTS, 3).split("\n") if row[:3] != "a,5"),
        "F=planner+agents M=time_s",
    ),
    "speeds, of which several runs were lost": (
        "robot,speed,energy_J\n"
        + "".join(f"{'ab'[n // 6]},{n % 2 + 1},{n * 37 % 11}.{n}\n" for n in range(12) if n % 4),
        "F=robot+speed M=energy_J",
    ),
    "angles that count like answers, of which several runs were lost": (
        "arm,angle_deg,error_mm\n"
        + "".join(f"{'ab'[n // 15]},{n % 5 + 1},{n * 37 % 11}.{n}\n" for n in range(30) if n not in {0, 5}),
        "F=arm+angle_deg M=error_mm",
    ),
    "numbers of configurations": (
        made("config,task,mode,energy", MODES, config="2{c}"),
        "F=task+mode M=energy X=config",
    ),
    "numbers of conditions, after a measure": (
        made("task,mode,energy,condition,test_case", MODES, condition="2{c}", test_case="3{c}"),
        "F=task+mode M=energy X=condition+test_case",
    ),
    "what is computed of numbers that were varied": (
        made("total_load,robots,payload,makespan", {"robots": ["2", "4"], "payload": ["3", "5"]}, total_load="1{c}"),
        "F=robots+payload M=makespan X=total_load",
    ),
    "paths that a planner finds again in each of many maps": (
        made("map,path_m,time_s", {"map": [f"m{n}" for n in range(14)]}, path_m="{c}.25"),
        "F=map M=path_m+time_s",
    ),
    # Seeds, days, and durations on a clock.
    "the same seed for all runs": (
        made("seed,planner,map,reward", PLANNER | MAPS, 1, seed="42"),
        "F=seed+planner+map M=reward",
    ),
    "versions that look like days": (
        "version,gpu,fps\n"
        + "".join(f"{v},{g},{30 + n * 37 % 11 / 7:.2f}\n" for n, (v, g) in enumerate([*VERSIONS, *VERSIONS])),
        "F=version+gpu M=fps",
    ),
    "durations on a clock that were planned": (
        made("duration,planner,energy", {"duration": ["05:00", "10:00"]} | PLANNER),
        "F=duration+planner M=energy",
    ),
    "seeds that all combinations have": (
        made("planner,map,seed,reward", PLANNER | MAPS, 4, seed="{rep}11"),
        "F=planner+map+seed M=reward ?=seed",
    ),
    "days that do not have every combination": (
        made("date,planner,map,energy", PLANNER | MAPS, 1, date="2024-05-0{even}"),
        "F=planner+map M=energy X=date",
    ),
    "days of shuffled runs": (
        made("date,planner,rep,energy", PLANNER, 6, date="0{other}.5.2024", rep="{rep}")
        .replace("false", "1")
        .replace("true", "2"),
        "rep=rep F=planner M=energy X=date",
    ),
    "durations on a clock": (
        made("planner,duration,energy", PLANNER, 4, duration="00:1{c}:2{r}"),
        "F=planner M=energy X=duration ?=duration",
    ),
    "standard order": (made("StdOrder,task,energy", TASK, StdOrder="{one}"), "id=StdOrder F=task M=energy"),
    "subjects, and the order in which each had all conditions": (
        "subject,condition,order,errors\n"
        + "".join(
            f"{s},{'abc'[(s + o) % 3]},{o + 1},{10 + (9 * s + o) * 37 % 101}\n" for s in range(1, 7) for o in range(3)
        ),
        "F=subject+condition+order M=errors",
    ),
    # What treatments are tried on, as in R's CO2 and nlme's RatPupWeight.
    "plants that each have one treatment": (
        "Plant,Type,conc,uptake\n"
        + "".join(
            f"p{n // 6},{('north', 'south')[n // 18]},{n % 3 * 100 + 95},{n * 37 % 101 / 7:.4f}\n" for n in range(36)
        ),
        "F=Type+conc M=uptake X=Plant ?=Plant",
    ),
    "litters that each have one treatment, after the measures": (
        "weight,sex,litter,Treatment\n"
        + "".join(
            f"{n * 37 % 101 / 7:.4f},{'fm'[n % 2]},{litter},{('low', 'high', 'none')[litter % 3]}\n"
            for litter in range(9)
            for n in range(12 * litter, 12 * litter + (4 if litter % 3 == 2 else 12))
        ),
        "F=sex+Treatment M=weight X=litter ?=litter",
    ),
}


@pytest.mark.parametrize(("text", "expected"), SHAPES.values(), ids=SHAPES.keys())
def test_columns_are_what_they_look_like(tmp_path, text, expected):
    roles = roles_of(read_foreign_table(write(tmp_path / "run_table.csv", text)), ImportDescription())
    assert summary(roles) == expected


def test_run_ids_that_contradict_all_columns_tell_no_combinations(tmp_path):
    """As of a config that shuffles the run table and applies treatments of its own, one after the other."""
    lines = ["__run_id,__done,governor,load,energy"]
    planned = [(number, repetition) for repetition in range(5) for number in range(6)]
    treatments = product(("powersave", "performance"), ("low", "mid", "high"), range(5))
    for place, (governor, load, _) in enumerate(treatments):
        number, repetition = planned[place * 7 % 30]
        lines.append(f"run_{number}_repetition_{repetition},DONE,{governor},{load},{10 + (place * 37 % 101) / 7:.4f}")
    roles = guessed(tmp_path, "\n".join(lines) + "\n")
    assert summary(roles) == "id=__run_id done=__done F=governor+load M=energy"
    assert roles.notes == (
        "no column agrees with the combinations that __run_id names (run_0_repetition_0, ...): these are not used",
    )


def test_moments_since_1970_under_the_name_of_a_measure_are_asked_about(tmp_path):
    text = made("__run_id,__done,task,energy_J,watts", TASK, energy_J="17610828{n:02}543", watts="{x:.1f}", **IDS)
    roles = guessed(tmp_path, text)
    assert summary(roles) == "id=__run_id done=__done rep=@ F=task M=energy_J+watts ?=energy_J"
    assert {guess.column: guess.reason for guess in roles.guesses}["energy_J"] == (
        "its numbers grow from row to row like moments in ms since 1970 (from 2025-10-21)"
    )
    (said,) = guessed(tmp_path, text, measures=("energy_J",)).unsure or ("nothing",)
    assert said == "nothing"


def test_large_counts_are_no_moments(tmp_path):
    text = made("__run_id,__done,task,instructions", TASK, instructions="17610{q}28000{n:02}", **IDS)
    assert summary(guessed(tmp_path, text)) == "id=__run_id done=__done rep=@ F=task M=instructions"


def test_one_text_in_all_rows_is_not_said_to_have_one_run_each(tmp_path):
    roles = guessed(tmp_path, made("seed,attribution,energy", {"attribution": ["per_device"]}, 6, seed="{x:.0f}"))
    assert "attribution" in roles.extras


REPEATED = made("task,repetition,energy", TASK, repetition="{rep}")


def guessed(tmp_path, text, **said):
    return roles_of(read_foreign_table(write(tmp_path / "run_table.csv", text)), ImportDescription(**said))


def test_a_text_that_as_many_runs_lack_is_asked_about_as_an_empty_cell_may_be_a_treatment(tmp_path):
    runs = [(n, r) for r in range(3) for n in range(2)]
    rows = [f"run_{n}_repetition_{r},{'-f' * n},{10 + n + r / 7}" for n, r in runs]
    (flags,) = guessed(tmp_path, "\n".join(["__run_id,flags,energy", *rows, ""])).unsure
    assert (flags.column, flags.reason) == ("flags", "text that as many runs lack: is an empty cell a treatment?")


def test_a_remark_on_one_run_is_no_treatment(tmp_path):
    runs = [(n, r) for r in range(3) for n in range(2)]
    rows = [f"run_{n}_repetition_{r},{'it fell' * (n + r == 0)},{10 + n + r / 7}" for n, r in runs]
    roles = guessed(tmp_path, "\n".join(["__run_id,note,energy", *rows, ""]))
    assert (roles.extras, roles.unsure) == (("note",), ())


def test_numbers_among_words_are_not_called_numbers(tmp_path):
    versions = {"version": ["3.1", "3.2", "4-scout"]}
    guesses = guessed(tmp_path, made("__run_id,__done,version,energy", versions, **IDS)).guesses
    assert {guess.column: guess.reason for guess in guesses}["version"] == (
        "3 values, the same in all repetitions of a combination"
    )


def test_each_guess_has_a_reason(tmp_path):
    roles = guessed(tmp_path, SHAPES["a nearly constant measure"][0])
    assert [guess.column for guess in roles.guesses] == ["__run_id", "__done", "task", "swap", "energy"]
    assert {guess.column: guess.reason for guess in roles.guesses}["swap"] == (
        "it differs between the repetitions of a combination"
    )
    assert all(guess.confidence is Confidence.SURE for guess in roles.guesses)


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ({"factors": ("level",)}, "F=level M=energy"),
        ({"measures": ("level",)}, "M=level+energy"),
        ({"ignore": ("level",)}, "M=energy"),
    ],
)
def test_what_is_said_of_one_column_settles_that_one(tmp_path, said, expected):
    assert summary(guessed(tmp_path, SHAPES["few numbers, unevenly, with no word for it"][0], **said)) == expected


@pytest.mark.parametrize(
    ("text", "said", "expected"),
    [
        ("Lauf,planner,world,energy_J", {"measures": ("energy_J",)}, "id=Lauf F=planner+world M=energy_J"),
        ("Lauf,planner,world,energy_J", {"factors": ("planner", "world")}, "id=Lauf F=planner+world M=energy_J"),
        ("planner,Lauf,world,energy_J", {"ignore": ("planner",)}, "F=world M=Lauf+energy_J"),
    ],
)
def test_the_first_column_counts_the_rows_whatever_is_said_of_others(tmp_path, text, said, expected):
    both = {"planner": ["a", "b"], "world": ["x", "y"]}
    assert summary(guessed(tmp_path, made(text, both, 2, Lauf="{one}"), **said)) == expected


@pytest.mark.parametrize(
    ("text", "said", "expected"),
    [
        (SHAPES["subjects"][0], {"block": "subject"}, "block=subject F=task M=energy"),
        (REPEATED, {"block": "repetition"}, "rep=repetition block=repetition F=task M=energy"),
        (SHAPES["three robots"][0], {"factors": ("robot",)}, "rep=repetition F=robot+task M=energy"),
    ],
)
def test_blocks_are_as_they_are_said(tmp_path, text, said, expected):
    assert summary(guessed(tmp_path, text, **said)) == expected


def test_numbers_that_count_from_1_in_each_combination_may_be_repetitions_in_another_language(tmp_path):
    roles = guessed(tmp_path, made("task,Wiederholung,energy", TASK, 4, Wiederholung="{rep}"))
    assert (roles.factors, roles.repetition) == (("task", "Wiederholung"), None)
    (note,) = roles.notes
    assert note == (
        "Wiederholung counts from 1 to 4, and each combination has every number once: repetitions? Then say "
        "--repetition Wiederholung"
    )
    assert guessed(tmp_path, made("task,speed,energy", TASK | {"speed": ["1", "3", "4"]}, 1)).notes == ()
    (note,) = guessed(tmp_path, made("task,day,energy", TASK, 4, day="{rep}")).notes
    assert note.startswith("day is taken for a block")


def test_numbered_texts_that_each_combination_has_once_are_asked_about_with_what_settles_it(tmp_path):
    text = made("Subject,task,energy", {"Subject": ["P 01", "P 02", "P 03"]} | TASK, 1)
    (guess,) = guessed(tmp_path, text).unsure
    assert guess.reason == (
        "its texts are numbered, and each combination has every one once: a repetition (--repetition), or one that "
        "treatments are compared within (--block)?"
    )
    assert guessed(tmp_path, text, block="Subject").unsure == ()
    assert guessed(tmp_path, text, repetition="Subject").unsure == ()


def test_numbers_one_of_which_is_in_words_are_counted_as_well(tmp_path):
    (note,) = guessed(tmp_path, "task,Lauf,energy\na,1,0.5\na,r2,1.5\na,3,2.5\nb,1,3.5\nb,r2,4.5\nb,3,5.5\n").notes
    assert note.startswith("Lauf counts from 1 to 3, and each combination has every number once: repetitions?")


def test_what_may_be_a_block_is_noted_with_its_option(tmp_path):
    (note,) = guessed(tmp_path, SHAPES["subjects"][0]).notes
    assert note == "subject has every combination for each of its values: a block? Then say --block subject"
    numbered = SHAPES["three robots"][0].replace("robot,", "Robot No.,")
    (note,) = guessed(tmp_path, numbered).notes
    assert note == "Robot No. is taken for a block; if it is a treatment, say --factor 'Robot No.'"


def test_a_subject_that_had_every_condition_is_noted_also_beside_the_order_of_these(tmp_path):
    text = SHAPES["subjects, and the order in which each had all conditions"][0]

    roles = roles_of(read_foreign_table(write(tmp_path / "run_table.csv", text)), ImportDescription())

    assert "subject has every condition for each of its values: a block? Then say --block subject" in roles.notes


def test_a_description_without_guesses_is_complete(tmp_path):
    text = SHAPES["factors after measures"][0]
    roles = guessed(tmp_path, text, factors=("task",), measures=("energy",), guess=False)
    assert summary(roles) == "F=task M=energy X=time_s+mode"
    counted = made("n_obst,task,energy", TASK, n_obst="{one}")
    assert summary(guessed(tmp_path, counted, factors=("task",), guess=False)) == "F=task M=n_obst+energy"


def test_a_column_that_is_taken_for_ids_as_it_counts_the_rows_is_noted_with_its_options(tmp_path):
    text = made("payload,planner,energy", PLANNER, 3, payload="{one}")
    roles = guessed(tmp_path, text)
    assert summary(roles) == "id=payload F=planner M=energy"
    (note,) = roles.notes
    assert note == (
        "payload counts the rows and is taken for the run's id; if it was varied or measured, say --factor or "
        "--measure payload"
    )
    assert summary(guessed(tmp_path, text, factors=("payload", "planner"))) == "F=payload+planner M=energy"
    assert summary(guessed(tmp_path, text, measures=("payload", "energy"))) == "F=planner M=payload+energy"


def test_a_column_has_one_role(tmp_path):
    with pytest.raises(AnalysisError, match="column 'task' is said to be factor and ignored"):
        guessed(tmp_path, SHAPES["R's index"][0], factors=("task",), ignore=("task",))
