"""Write docs/cli.md from the program itself: `generate_cli_page.py`, or with `--check` say whether it is current."""

from __future__ import annotations

import argparse
import re
import sys
import textwrap
from pathlib import Path

from robot_runner.cli.commands import command_module, installed_commands
from robot_runner.cli.main import overview
from robot_runner.cli.parser import Parser, parser_of

_PAGE = Path(__file__).parents[1] / "docs" / "cli.md"
#: How many characters of code a page shows in a line, and where the overview's descriptions go on in the next.
_WIDTH, _INDENT = 96, 19
#: Stands for a space at which no line may end.
_HELD = "\0"

_HEAD = """\
# Command line

<!-- Written by scripts/generate_cli_page.py from the program itself: do not edit. -->

```text
{overview}
```

## Exit codes

| code | means |
|---|---|
| 0 | all is done |
| 1 | a run failed |
| 2 | refused: the command, the config or the experiment's folder is not as it must be; nothing was executed |
| 3 | `replicate`: every run was executed, and the results are different |
| 4 | `replicate`: every run was executed; whether the results agree is undecided, or nothing could be compared |
| 70 | a fault of Robot Runner itself; the traceback is kept in a file that is named |
| 130 | interrupted by Ctrl-C: what was open was closed, and the experiment can be resumed |

Errors go to stderr: one problem, where it is, and beneath it how to correct it. With `--json`, nothing but JSON goes to
stdout. Colours are used on a terminal only, and never where the environment variable `NO_COLOR` is set.
"""


def main() -> int:
    """Write the page, or compare it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail where the page is not current")
    chosen = parser.parse_args()
    page = current_page()
    if not chosen.check:
        _PAGE.write_text(page, encoding="utf-8")
    elif not _PAGE.exists() or _PAGE.read_text(encoding="utf-8") != page:
        print("docs/cli.md is not current: execute `make cli-page`, and commit what it writes.")
        return 1
    return 0


def current_page() -> str:
    """Return what the page is to hold."""
    names = installed_commands()
    folded = "\n".join(_wrapped(line, indent=_INDENT) for line in overview().splitlines())
    return "\n".join([_HEAD.format(overview=folded), *map(_section, names)])


def _wrapped(line: str, *, indent: int) -> str:
    """Fold a line that is too wide for a page at 1280 px; an option and its value stay together."""
    whole = re.sub(r"\[[^\]]*\]", lambda option: option[0].replace(" ", _HELD), line)
    folded = textwrap.fill(
        whole, _WIDTH, subsequent_indent=" " * indent, break_on_hyphens=False, break_long_words=False
    )
    return folded.replace(_HELD, " ")


def _section(command: str) -> str:
    module = command_module(installed_commands()[command])
    actions = module.action_parsers() if hasattr(module, "action_parsers") else {}
    return "\n".join(
        [_described("##", parser_of(command, module)), *(_described("###", each) for each in actions.values())]
    )


def _described(level: str, parser: Parser) -> str:
    lines = [
        f"{level} {parser.prog}",
        "",
        parser.description or "",
        "",
        "```text",
        _wrapped(_usage(parser), indent=4),
        "```",
        "",
    ]
    lines += ["| argument | means |", "|---|---|"]
    lines += [f"| `{_name(action)}` | {_cell((action.help or '') % vars(action))} |" for action in parser.documented]
    return "\n".join([line.rstrip() for line in lines]) + "\n"


# Not argparse's own: it words and folds a usage differently in each version of Python.
#: How often a word may be given, by argparse's sign of it.
_FORMS = {"?": "[{}]", "*": "[{} ...]", "+": "{} ..."}


def _usage(parser: Parser) -> str:
    words = [parser.prog]
    for action in parser.documented:
        if not action.option_strings:
            words.append(_FORMS.get(str(action.nargs), "{}").format(_name(action)))
        elif action.option_strings[0] != "-h":
            words.append(_name(action).replace(" ", _HELD) if action.required else f"[{_name(action)}]")
    return " ".join(words)


def _name(action: argparse.Action) -> str:
    if not action.option_strings:
        return str(action.metavar or action.dest)
    names = ", ".join(action.option_strings)
    return names if action.nargs == 0 else f"{names} {_value(action)}"


def _value(action: argparse.Action) -> str:
    choices = f"{{{','.join(map(str, action.choices))}}}" if action.choices else action.dest.upper()
    return str(action.metavar or choices)


def _cell(text: str) -> str:
    sentence = text[:1].upper() + text[1:]
    return sentence.replace("|", "\\|") + ("" if sentence.endswith(".") else ".")


if __name__ == "__main__":
    sys.exit(main())
