"""The commands, one module each; a module is imported when its command is called."""

from __future__ import annotations

from keyword import iskeyword

__all__ = ["COMMANDS", "module_of"]

#: What each command does, in the order in which a user meets them.
COMMANDS = {
    "demo": "Execute the paper's experiment on the embedded robot.",
    "new": "Write a commented config that runs as it is.",
    "check": "Say everything that is wrong with a config, and touch nothing.",
    "plan": "Show the run table before anything is executed.",
    "run": "Execute an experiment, or resume it.",
    "status": "Show how far an experiment is, also while it is executed.",
    "continue": "Let an experiment that waits between two runs go on.",
    "convert": "Write a config of an earlier tool in our own spelling.",
    "export": "Write an experiment's results for other tools: Parquet and a data package.",
    "import": "Adopt results of an earlier tool, or made by hand.",
    "report": "Write the report of an experiment: tables, figures, tests, threats to validity.",
    "compare": "Compare two experiments, and say whether they are equivalent.",
    "pack": "Seal an experiment as one file that anyone can check and execute again.",
    "verify": "Check whether a package is intact.",
    "replicate": "Execute a package again, and say whether the results agree.",
    "explain": "Say where the values of a run come from.",
    "fit-power-model": "Fit a software power model to the measured runs of an experiment.",
    "plugins": "List the installed plugins, with their measures and parameters.",
    "simulate": "Offer the embedded robot on a ROS graph, as if it were a real one.",
    "try": "Try a profiler without an experiment.",
}

#: The rooms of the commands that are not the core's own.
_ROOMS = {
    "compare": "analysis",
    "convert": "legacy",
    "explain": "replication",
    "export": "analysis",
    "fit-power-model": "meters",
    "import": "analysis",
    "pack": "replication",
    "replicate": "replication",
    "report": "analysis",
    "simulate": "simulator",
    "verify": "replication",
}


def module_of(command: str) -> str:
    """Return the module that implements a command.

    Example:
        >>> module_of("continue")  # a word of Python, so its module has another name
        'robot_runner.cli.commands.continue_'
    """
    room = _ROOMS.get(command, "cli")
    return f"robot_runner.{room}.commands.{command.replace('-', '_')}{'_' if iskeyword(command) else ''}"
