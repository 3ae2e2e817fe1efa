"""Saves the values at the master of ROS 1 of the parameters that a launch sets, and restores them after its end.

roslaunch leaves at the master whatever it has set. A later run whose launch does not set all of that would find it
there: it would depend on the order of runs. What was there is kept at the master itself, which forgets it together with
the parameters. A run that was killed has put nothing back: the next start does so before it keeps what it will change.

Two launches at one master may set the same, as `/use_sim_time`, and end in any order. A value stays as long as a launch
that began later goes on: that one restores, in its place, what was there before both.

Executed where the subject is, by its Python, of version 3.6 or later: `KEY [COMMAND...]`, where the command writes the
parameters of the launch as `roslaunch --dump-params` does; without one, they are only put back.
"""

# ruff: noqa: UP031

import os
import re
import socket
import subprocess
import sys
import xmlrpc.client

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

#: The parameter below which the saved values are kept; no node of a robot has this name.
KEPT = "/robot_runner_kept"
CALLER = "/robot_runner"
#: The timeout for an answer of the master, s.
PATIENCE = 5.0
#: The keys of a YAML mapping of parameters, each with its full name; long ones begin with a question mark.
NAME = re.compile(r"""^(?:\? )?(['"]?)(/[^\n]*?)\1(?::(?= |$)|$)""", re.MULTILINE)


class Master:
    """The parameters of a master."""

    def __init__(self, uri: str) -> None:
        self._server = xmlrpc.client.ServerProxy(uri)

    def value(self, name: str) -> "tuple[Any, ...]":
        """Return a value as a tuple of one; an empty one where there is none."""
        code, _, value = self._asked("getParam", name)
        return (value,) if code == 1 else ()

    def change(self, name: str, value: "tuple[Any, ...]") -> None:
        """Set a value that `value` has returned, also that there is none."""
        if value:
            self._asked("setParam", name, value[0])
        else:
            self._asked("deleteParam", name)

    def _asked(self, method: str, *given: "Any") -> "tuple[int, str, Any]":
        code, message, value = getattr(self._server, method)(CALLER, *given)
        return code, message, value


def names_of(command: "list[str]") -> "list[str]":
    """Return the names of the parameters that a launch sets."""
    done = subprocess.run(  # noqa: S603 - an argument list
        command, check=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
    )
    return list(dict.fromkeys(found[1] for found in NAME.findall(done.stdout.decode("utf-8", "replace"))))


def put_back(master: Master, key: str) -> None:
    """Restore the saved values, if there are any, or have a launch that began later restore them."""
    others = (master.value(KEPT) or ({},))[0]
    own = others.pop(key, [])
    for name, before, *number in own:
        later = [
            (each[2], other, each)
            for other, kept in others.items()
            for each in kept
            if each[0] == name and each[2:] > number
        ]
        if later:
            _, other, following = min(later)
            following[1] = before
            master.change("%s/%s" % (KEPT, other), (others[other],))
        else:
            master.change(name, tuple(before))
    if own:
        master.change("%s/%s" % (KEPT, key), ())


def keep(master: Master, key: str, names: "list[str]") -> None:
    """Save the present values of these parameters, with a number by which launches are ordered."""
    if names:
        everything = (master.value("/") or ({},))[0]
        all_kept = (found(everything, KEPT) or ({},))[0].values()
        number = 1 + max([0, *(one for kept in all_kept for each in kept for one in each[2:])])
        kept = [[name, list(found(everything, name)), number] for name in names]
        master.change("%s/%s" % (KEPT, key), (kept,))


def found(tree: "Any", name: str) -> "tuple[Any, ...]":
    """Return what a tree of parameters has by a name, as a tuple of one; an empty one where it has none.

    Example:
        >>> found({"nav": {"speed": 0.2}}, "/nav/speed"), found({"nav": 1}, "/nav/speed")
        ((0.2,), ())
    """
    for part in name.strip("/").split("/"):
        if not isinstance(tree, dict) or part not in tree:
            return ()
        tree = tree[part]
    return (tree,)


def main(key: str, command: "list[str]") -> None:
    """Restore the saved values, then save those that the launch of this command will change, if there is one."""
    socket.setdefaulttimeout(PATIENCE)
    master = Master(os.environ.get("ROS_MASTER_URI") or "http://localhost:11311")
    try:
        put_back(master, key)
    except ConnectionRefusedError:
        return  # a launch that starts a master of its own takes the parameters along
    if command:
        keep(master, key, names_of(command))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
