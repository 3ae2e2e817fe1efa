"""Makes the treatments of `Factor.revisions`: finds out which commits are meant, and builds a work tree of each."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robot_runner.core.config.treatment_makers import Workshop
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.revision import Revision
from robot_runner.core.errors import ExecutionError, Finding, did_you_mean, nearest
from robot_runner.core.storage.git_repository import ADVISED, git, repository_state, without_login
from robot_runner.subjects.surroundings import cache_findings
from robot_runner.subjects.work_tree import WorkTree, is_kept, kept_name, refusal

_INSTALL = "Install git (Debian, Ubuntu: sudo apt install git)."
_URL = re.compile(r"[a-z][a-z0-9+.-]*://|[\w.-]+@[\w.-]+:")
_HASH = re.compile(r"[0-9a-f]{40}(?:[0-9a-f]{24})?")
_SHORT = 12  # digits of a hash that a person reads
#: In which order git itself looks for a name (gitrevisions), and what an annotated tag stands for.
_REFERENCES = ("refs/tags/{}^{{}}", "refs/tags/{}", "refs/heads/{}", "{}")


def _place(repository: str) -> str:
    return repository if _URL.match(repository) else str(Path(repository).expanduser().absolute())


class Repository:
    """A repository that revisions are taken from: a folder of this machine, or a URL.

    Raises:
        ExecutionError: git is not installed, or there is no repository.
    """

    def __init__(self, place: str) -> None:
        self.is_remote = _URL.match(place) is not None
        self.place = _place(place)
        listed = ("for-each-ref", "--format=%(objectname)\t%(refname)")
        words = ("ls-remote", "--", self.place) if self.is_remote else listed
        try:
            answer = git(*words, folder="." if self.is_remote else self.place)
            above = b"" if self.is_remote else git("rev-parse", "--show-cdup", folder=self.place).stdout.strip()
        except FileNotFoundError as error:
            there = self.is_remote or Path(self.place).is_dir()
            problem = "git is not installed" if there else f"there is no folder {self.place!r}"
            fix = _INSTALL if there else "Name the folder of a repository, or a URL."
            raise ExecutionError(problem, where=without_login(place), fix=fix) from error
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ExecutionError(f"git does not answer: {error}", where=without_login(place)) from error
        if answer.returncode != 0:
            advised = ADVISED.search(answer.stderr)
            fix = f"Execute: {advised[0].decode()}" if advised else "Name the folder of a repository, or a URL."
            raise ExecutionError(f"git finds no repository: {refusal(answer)}", where=without_login(place), fix=fix)
        if above:
            whole = (Path(self.place) / above.decode(errors="replace")).resolve()
            problem = f"this is a folder within the repository {str(whole)!r}, which can be cloned as a whole only"
            raise ExecutionError(problem, where=place, fix=f"Name {str(whole)!r}.")
        lines = answer.stdout.decode(errors="replace").splitlines()
        self._commits = {name: commit for commit, _, name in (line.partition("\t") for line in lines)}

    def commit_of(self, name: str) -> str | None:
        """Return the commit that a name means now; None where it means none."""
        if self.is_remote:
            found = (self._commits.get(reference.format(name)) for reference in _REFERENCES)
            return next(filter(None, found), name if _HASH.fullmatch(name) else None)
        answer = git("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}", folder=self.place)
        return answer.stdout.decode().strip() if answer.returncode == 0 else None

    def names(self) -> list[str]:
        """Return its branches and tags."""
        return sorted({re.sub(r"^refs/\w+/|\^\{\}$", "", name) for name in self._commits})


class _Revisions:
    """The maker of revisions; it is announced in the group `robot_runner.preparations`."""

    def findings(self, factors: Sequence[Factor], known: Mapping[str, Any]) -> Iterator[Finding]:
        """Yield revisions that are not there, that are the same, and that have moved since the experiment began."""
        for factor, revisions in _grouped(factors):
            yield from cache_findings(f"factor {factor.name!r}")
            for place in dict.fromkeys(each.repository for each in revisions):
                where = f"factor {factor.name!r}"
                ours = [each for each in revisions if each.repository == place]
                facts = known.get(factor.name, {})
                try:
                    repository = Repository(place)
                except ExecutionError as error:
                    if not all(each.name in facts for each in ours):  # their work trees may still be there
                        yield Finding.error(f"{where}, {error.where}", error.problem, error.fix)
                    continue
                yield from _found(where, repository, ours, facts)

    def prepare(self, factors: Sequence[Factor], known: Mapping[str, Any], workshop: Workshop) -> dict[str, Any]:
        """Build a work tree of each revision, at the commit that it meant when the experiment first began.

        Raises:
            ExecutionError: there is no such revision, or it cannot be built.
            KeyboardInterrupt: the user has interrupted it.
        """
        made: dict[str, Any] = {}
        for factor, revisions in _grouped(factors):
            copies: dict[str, dict[str, Path]] = {}
            facts_of: dict[str, Any] = made.setdefault(factor.name, {})
            for revision in revisions:
                facts = known.get(factor.name, {}).get(revision.name)
                copy = workshop.logs / facts["kept"] if facts is not None and facts.get("kept") else None
                tree = WorkTree(_place(revision.repository), _commit(factor, revision, facts), revision.build, copy)
                log = workshop.logs / factor.name / f"{re.sub(r'[^A-Za-z0-9._-]', '_', revision.name)}.log"
                built = tree.made(revision.name, log, workshop)
                revision.prepare(commit=tree.commit, path=str(tree.folder))
                place = without_login(tree.repository)
                told = {"repository": place, "commit": tree.commit, "build": revision.build, "path": revision.path}
                facts_of[revision.name] = told | built | {"kept": kept_name(place)}
                copies.setdefault(kept_name(place), {})[tree.commit] = tree.folder
            kept = {name for name, clones in copies.items() if is_kept(workshop.logs / name, clones)}
            for each in facts_of.values():
                each["kept"] = each["kept"] if each["kept"] in kept else None
        return made


REVISIONS = _Revisions()


def _grouped(factors: Sequence[Factor]) -> Iterator[tuple[Factor, list[Revision]]]:
    for factor in factors:
        revisions = [each for each in factor.treatments if isinstance(each, Revision)]
        if revisions:
            yield factor, revisions


def _commit(factor: Factor, revision: Revision, facts: Mapping[str, Any] | None) -> str:
    """Return the commit that a revision meant first, or means now."""
    if facts is not None:
        return str(facts["commit"])
    commit = Repository(revision.repository).commit_of(revision.name)
    if commit is None:
        fix = "Name another revision."
        raise ExecutionError(f"there is no revision {revision.name!r}", where=f"factor {factor.name!r}", fix=fix)
    return commit


def _found(where: str, repository: Repository, ours: Sequence[Revision], facts: Mapping[str, Any]) -> Iterator[Finding]:
    where = f"{where}, {without_login(repository.place)}"
    state = None if repository.is_remote else repository_state(repository.place)
    if state is not None and state.is_dirty:
        problem = "the repository has changes that were not committed: they are in none of the revisions"
        yield Finding.warning(where, problem, "Commit them, and name that commit, if they are meant.")
    named: dict[str, str] = {}
    for revision in ours:
        name, commit = revision.name, repository.commit_of(revision.name)
        first = facts.get(name, {}).get("commit")
        if commit is None and first is None:
            yield Finding.error(where, f"there is no revision {name!r}", _nearest(name, repository.names()))
        elif first is not None and commit != first:
            now = f"is {commit[:_SHORT]} now" if commit is not None else "is not there any more"
            problem = f"{name!r} {now}, and was {first[:_SHORT]} when the experiment began, with which it goes on"
            yield Finding.warning(where, problem, "Choose another experiment_name to measure what it is now.")
        meant = first or commit or name
        if meant in named:
            problem = f"{named[meant]!r} and {name!r} are one commit, {meant[:_SHORT]}"
            yield Finding.warning(where, f"{problem}: there is no difference to be measured", "Leave one of them out.")
        named.setdefault(meant, name)


def _nearest(name: str, names: list[str]) -> str:
    near = nearest(name, names, least=0.5)
    return f"Did you mean {near!r}?" if near is not None else did_you_mean(name, names) or "Commit something first."
