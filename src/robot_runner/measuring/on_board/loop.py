"""Sample a Linux computer's utilisation or files from inside: one long-lived process, controlled by its input.

It is sent to the robot as text and executed by the Python there. So it keeps to Python 3.6, and to modules that are
fast to import. Messages are lines of fields, separated by tabs:

    asked                                            answered
    clock  NUMBER                                    clock  NUMBER  STEADY  WALL
    utilisation  RATE  TOKEN or -  SELECTOR...       begun  FILE or -  CORES  RATE
    files  RATE  TOKEN or -  PATH...                 begun  FILE or -  CORES  RATE
    stop                                             s or f lines, then  end  CPU_SECONDS
    read  PATH...                                    lines  =LINE or - ...
    list  PATTERN                                    paths  PATH...
    recover  FILE                                    s or f lines, then  end  -
    leftovers  OWNER                                 paths  FILE...
    discard  FILE                                    discarded  FILE
    lease  SECONDS                                   (go on for this long after the connection was cut)
    leave                                            (do not go on)

    s  STEADY  CORE:TOTAL:IDLE,...  TOTAL:AVAILABLE  SELECTOR:PID:STARTED:CPU_SECONDS:BYTES,...
    f  STEADY  =LINE or - ...

With a TOKEN, samples are kept in a file named after it until `stop`; with `-` they are sent at once. If the input ends
while samples are kept, the loop runs on for its lease, so that they can be recovered. A token begins with its owner:
leftovers are all files of one owner.
Memory is in kB; CORE is empty for all cores together.
"""
# Importing pathlib would double the time that Python needs to start on a small computer.
# ruff: noqa: PTH108, PTH110, PTH111, PTH115, PTH118, PTH119, PTH123, PTH207, PTH208

import glob
import io
import os
import select
import signal
import sys
import time

TICK = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")
CORES = os.sysconf("SC_NPROCESSORS_ONLN")
SINCE_BOOT = 7  # CLOCK_BOOTTIME of Linux, for which Python has a name from 3.7 on
OPTIONS_WITH_VALUE = ("-X", "-W")  # of Python
STARTERS = {"ros2", "sudo", "timeout", "gdb", "xterm"}  # have the whole command line of a node, and wait for it
INTERPRETERS = ("python", "perl", "ruby", "node", "sh", "bash", "dash")
SCAN = 0.04  # seconds at least between two searches for new processes and checks of young ones, which are expensive
YOUNG = 5.0  # seconds since its start during which a process may still execute another program
PREFIX = "robot-runner-samples-"
MOST = 1 << 18  # bytes of /proc/stat: enough for a computer with hundreds of cores


def say(*words: object) -> None:
    """Send one message at once."""
    sys.stdout.write("\t".join(map(str, words)) + "\n")
    sys.stdout.flush()


def first_bytes(path: str, most: int = 4096) -> bytes:
    """Return at most this many bytes of a file, with -1 all of it; empty if it cannot be read."""
    try:
        with open(path, "rb", buffering=0) as file:
            return file.read(most)
    except OSError:
        return b""


def first_line(path: str) -> str:
    """Return the first line of a file after an equals sign, or a hyphen if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return "=" + file.readline(4096).decode("ascii", "replace").rstrip("\n").replace("\t", " ")
    except OSError:
        return "-"


class Files:
    """The first line of each of some files."""

    def __init__(self, paths: "list[str]") -> None:
        self.paths = paths

    def line(self) -> str:
        """Return the sample of this moment."""
        return "\t".join(["f", f"{time.monotonic():.6f}", *map(first_line, self.paths)])


class Utilisation:
    """Counters of the cores, of the memory, and of the processes that selectors match."""

    def __init__(self, selectors: "list[str]") -> None:
        self.stat = os.open("/proc/stat", os.O_RDONLY)
        self.meminfo = os.open("/proc/meminfo", os.O_RDONLY)
        self.processes = Processes(selectors) if selectors else None

    def line(self) -> str:
        """Return the sample of this moment."""
        now = time.monotonic()
        cores = []
        for line in os.pread(self.stat, MOST, 0).split(b"\n"):
            if not line.startswith(b"cpu"):
                break
            name, *fields = line.split()
            ticks = list(map(int, fields[:8]))
            cores.append(f"{name[3:].decode()}:{sum(ticks)}:{ticks[3] + ticks[4]}")
        memory = memory_of(os.pread(self.meminfo, 4096, 0))
        processes = self.processes.counters(now) if self.processes else []
        return "\t".join(["s", f"{now:.6f}", ",".join(cores), memory, ",".join(processes)])


def memory_of(text: bytes) -> str:
    """Return total and available memory; kernels before 3.14 do not show the latter, which is estimated."""
    facts = {}
    for line in text.split(b"\n")[:8]:
        name, _, rest = line.partition(b":")
        facts[name] = int(rest.split()[0]) if rest else 0
    guess = facts.get(b"MemFree", 0) + facts.get(b"Buffers", 0) + facts.get(b"Cached", 0)
    return f"{facts[b'MemTotal']}:{facts.get(b'MemAvailable', guess)}"


class Processes:
    """The processes that selectors match at a time."""

    def __init__(self, selectors: "list[str]") -> None:
        self.selectors = [selector.partition(":")[::2] for selector in selectors]
        self.young_until = {}  # type: dict[str, float]
        self.matched = {}  # type: dict[str, list[int]]
        self.next_scan = 0.0

    def counters(self, now: float) -> "list[str]":
        """Return the counters of each process that matches."""
        if now >= self.next_scan:
            self.next_scan = now + SCAN
            self.scan(now)
        found = []
        for pid, places in self.matched.items():
            fields = fields_of(pid)
            if fields:
                cpu, reaped = ((int(fields[at]) + int(fields[at + 1])) / TICK for at in (11, 13))
                rest = f"{pid}:{fields[19].decode()}:{cpu:.3f}:{int(fields[21]) * PAGE}:{int(fields[1])}"
                for place in places:
                    # If a process's children are selected with it, then also those that lived between two samples.
                    children = reaped if self.selectors[place][0] == "subject" else 0.0
                    found.append(f"{place}:{rest}:{children:.3f}")
        return found

    def scan(self, now: float) -> None:
        """Search for processes that match; one that is not young any more keeps its program."""
        known, self.young_until = self.young_until, {}
        for pid in filter(str.isdigit, os.listdir("/proc")):
            until = self.young_until[pid] = known.get(pid) or now + YOUNG - age_of(pid)
            if pid not in known or now < until:
                self.matched[pid] = self.places(pid)
        self.matched = {pid: places for pid, places in self.matched.items() if places and pid in self.young_until}

    def places(self, pid: str) -> "list[int]":
        """Return which selectors a process matches."""
        words = first_bytes(f"/proc/{pid}/cmdline").decode("utf-8", "replace").split("\0")
        names = names_of(words, first_bytes(f"/proc/{pid}/comm").decode("utf-8", "replace").strip())
        found = [place for place, one in enumerate(self.selectors) if is_match(one[0], one[1], pid, names, words)]
        stat = fields_of(pid)
        parents = self.matched.get(stat[1].decode(), []) if stat else []
        # A process that a subject has started belongs to it, even if sudo removed the mark.
        return found + [at for at in parents if self.selectors[at][0] == "subject" and at not in found]


def fields_of(pid: str) -> "list[bytes]":
    """Return the fields of a process's stat from its state on (proc(5)); empty for one that has ended."""
    return first_bytes(f"/proc/{pid}/stat").rpartition(b")")[2].split()


def age_of(pid: str) -> float:
    """Return the age of a process, s."""
    fields = fields_of(pid)
    return time.clock_gettime(SINCE_BOOT) - int(fields[19]) / TICK if fields else 0.0


def names_of(words: "list[str]", known: str) -> "set[str]":
    """Return the names of a process: the kernel's, its program's, and that of the script or module."""
    program = os.path.basename(words[0]) if words else ""
    names = {known, program}
    left = iter(words[1:] if program.startswith(INTERPRETERS) else ())
    for word in left:
        if word == "-m":
            names.add(next(left, ""))
            break
        if word.startswith("-") and not word.startswith("--") and word.endswith("c"):
            break  # the program is on the command line
        if not word.startswith("-"):
            names.add(os.path.basename(word))
            break
        if word in OPTIONS_WITH_VALUE:
            next(left, "")
    return names


def is_match(kind: str, value: str, pid: str, names: "set[str]", words: "list[str]") -> bool:
    """Whether a selector matches a process."""
    if kind == "pid":
        return pid == value
    if kind == "subject":
        mark = f"ROBOT_RUNNER_SUBJECT={value}".encode()
        return mark in first_bytes(f"/proc/{pid}/environ", -1).split(b"\0")
    return is_node(value, words) if kind == "node" else value in names


def is_node(name: str, words: "list[str]") -> bool:
    """Whether a command line is that of the node of this name."""
    namespace, _, bare = name.strip("/").rpartition("/")
    is_there = not namespace or "__ns:=/" + namespace in words or "__ns:=" + namespace in words
    is_named = "__name:=" + bare in words or "__node:=" + bare in words
    return is_there and is_named and STARTERS.isdisjoint(map(os.path.basename, words[:2]))


class Loop:
    """Answers requests, and samples meanwhile."""

    def __init__(self) -> None:
        self.heard = b""
        self.source = None  # type: Utilisation | Files | None
        self.kept = None  # type: io.TextIOWrapper | None
        self.path = "-"
        self.period = self.due = self.cpu = self.flushed = self.lease = 0.0

    def run(self) -> None:
        """Run until the input ends, and for the lease after it if samples are kept."""
        while True:
            wait = None if self.source is None else max(0.0, self.due - time.monotonic())
            if select.select([0], [], [], wait)[0]:
                data = os.read(0, 65536)
                if not data:
                    self.go_on_alone()
                    return
                *lines, self.heard = (self.heard + data).split(b"\n")
                for line in lines:
                    self.answer(line.decode("utf-8").split("\t"))
            elif self.source is not None:
                self.sample(self.source)

    def go_on_alone(self) -> None:
        """Sample until the lease is over, or another session fetches or discards the samples."""
        end = time.monotonic() + self.lease
        while self.source is not None and self.kept is not None and time.monotonic() < end:
            if not os.path.exists(self.path):
                return
            time.sleep(max(0.0, min(self.due, end) - time.monotonic()))
            self.sample(self.source)

    def sample(self, source: "Utilisation | Files") -> None:
        """Take one sample; missed moments are skipped."""
        self.put(source.line())
        now = time.monotonic()
        self.due += max(1, int((now - self.due) / self.period)) * self.period
        if self.kept is not None and now - self.flushed > 1.0:
            self.kept.flush()
            self.flushed = now

    def put(self, line: str) -> None:
        """Keep a sample, or send it."""
        if self.kept is None:
            say(line)
        else:
            self.kept.write(line + "\n")

    def answer(self, words: "list[str]") -> None:
        """Execute the request of one line."""
        kind, rest = words[0], words[1:]
        if kind == "clock":
            say("clock", rest[0], f"{time.monotonic():.9f}", f"{time.time():.9f}")
        elif kind in {"utilisation", "files"}:
            self.begin(kind, float(rest[0]), rest[1], rest[2:])
        elif kind == "stop":
            self.end()
        elif kind == "read":
            say("lines", *map(first_line, rest))
        elif kind == "list":
            say("paths", *sorted(glob.glob(rest[0])))
        elif kind == "recover":
            recover(rest[0])
        elif kind == "leftovers":
            found = [path for each in folders() for path in glob.glob(f"{each}/{PREFIX}{rest[0]}-*")]
            say("paths", *filter(os.path.isfile, found))  # another user may have put a pipe there
        elif kind == "discard":
            discard(rest[0])
            say("discarded", rest[0])
        elif kind in {"lease", "leave"}:
            self.lease = float(rest[0]) if rest else 0.0
        else:
            say("error", "asked for", kind)

    def begin(self, kind: str, rate: float, token: str, about: "list[str]") -> None:
        """Start sampling."""
        self.kept, self.path = (None, "-") if token == "-" else opened(token)  # noqa: S105 - no password
        self.source = Utilisation(about) if kind == "utilisation" else Files(about)
        self.period = 1.0 / rate
        self.cpu = time.process_time()
        say("begun", self.path, CORES, rate)
        self.due = self.flushed = time.monotonic()

    def end(self) -> None:
        """Take a last sample, send the samples that were kept, and stop sampling."""
        if self.source is not None:
            self.put(self.source.line())
        cpu, self.source = time.process_time() - self.cpu, None
        if self.kept is not None:
            self.kept.close()
            self.kept = None
            send(self.path)
        say("end", f"{cpu:.6f}")


def folders() -> "list[str]":
    """Return the folders for samples, best first."""
    return [os.environ.get("TMPDIR") or "/tmp", "/var/tmp", os.path.expanduser("~")]  # noqa: S108 - only for its owner


def opened(token: str) -> "tuple[io.TextIOWrapper, str]":
    """Return a new file for samples, which only its owner can read, and its path."""
    for folder in folders():
        path = os.path.join(folder, PREFIX + token)
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        except OSError:
            continue
        file = io.TextIOWrapper(os.fdopen(descriptor, "wb"), encoding="utf-8")
        file.write(f"pid\t{os.getpid()}\n")
        file.flush()
        return file, path
    raise SystemExit("there is no folder that samples can be kept in")


def send(path: str) -> None:
    """Send the samples of a file, and remove it."""
    with open(path, encoding="utf-8") as file:
        for line in file:
            if line.startswith(("s\t", "f\t")) and line.endswith("\n"):  # the disk may have been full in the last one
                sys.stdout.write(line)
    os.unlink(path)


def end_holder(path: str) -> None:
    """End the loop that keeps its samples in a file, if it still runs."""
    pid = first_bytes(path).split(b"\n")[0].rpartition(b"\t")[2].decode("ascii", "replace")
    if pid.isdigit() and holds(pid, path):
        os.kill(int(pid), signal.SIGTERM)
        for _ in range(50):
            if not holds(pid, path):
                break
            time.sleep(0.05)


def discard(path: str) -> None:
    """Remove a file of samples that is not needed."""
    if os.path.basename(path).startswith(PREFIX):
        end_holder(path)
        if os.path.exists(path):
            os.unlink(path)


def recover(path: str) -> None:
    """End a loop that lost its connection, and send its samples."""
    end_holder(path)
    try:
        send(path)
    except OSError as error:
        say("error", error)
        return
    say("end", "-")


def holds(pid: str, path: str) -> bool:
    """Whether a process has a file open."""
    for link in glob.glob(f"/proc/{pid}/fd/*"):
        try:
            if os.readlink(link) == path:
                return True
        except OSError:
            continue
    return False


def leave(number: int, _: object) -> None:
    """Exit by an exception, so that files are closed."""
    raise SystemExit(128 + number)


def main() -> None:
    """Sample until the input ends; samples that were kept stay, to be recovered later."""
    signal.signal(signal.SIGTERM, leave)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # a cut connection is noticed by the end of the input
    loop = Loop()
    try:
        loop.run()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the interpreter flushes at its end
    finally:
        if loop.kept is not None:
            loop.kept.close()


if __name__ == "__main__":
    main()
