"""The live page in a real browser, beside experiments that are really executed."""

from __future__ import annotations

import json
import re
import signal
from typing import TYPE_CHECKING

import pytest
from tests.long_cases import soak_but
from tests.page.conftest import executed
from tests.waiting import wait_until

from robot_runner.core.storage.journal import read_journal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.headless_browser import Browser
    from tests.page.conftest import ServedPage

PHONE = {"width": 390, "height": 844, "is_phone": True}
STEP = """\
    operation_type = OperationType.SEMI
    operator_steps = [
        OperatorStep(
            "swap the battery",
            every=2,
            ask=[Question("voltage", float, unit="V", low=9, high=13), Question("dock", choices=["A", "B"])],
        ),
        OperatorStep("lift the robot", after=True),
    ]
"""


@pytest.fixture(autouse=True)
def _leave_the_page(browser: Browser) -> Iterator[None]:
    """Leave the page after a test, as it would go on asking a server that has ended."""
    yield
    browser.open("about:blank")


def text(browser: Browser, selector: str) -> str:
    return browser.evaluate(f"document.querySelector({json.dumps(selector)}).innerText")


def seen(selector: str, pattern: str) -> str:
    """Return the condition that an element is seen whose text has a pattern."""
    return (
        f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
        f" return Boolean(e && e.offsetParent && /{pattern}/.test(e.innerText)); }})()"
    )


def wait_for_whole_samples(browser: Browser, run: str) -> None:
    """Wait until what is shown of a run that has ended is what was kept, each curve once."""
    browser.wait_for(seen("#curves", f"Samples of {run}"))
    # Files of samples are completed one after the other while a run ends: the last of them is waited for.
    browser.wait_for(seen("#curve-choice", "Ina219 voltage V"))
    browser.wait_for("!document.getElementById('plots').innerText.includes('being taken')")
    names = browser.evaluate("[...document.querySelectorAll('#curve-choice button')].map(each => each.innerText)")
    assert len(names) == len({*names})


def pass_an_hour(browser: Browser) -> None:
    """Have the page believe that an hour has passed."""
    browser.evaluate("{ const now = performance.now.bind(performance); performance.now = () => now() + 36e5; }")


def left_an_hour_later(browser: Browser) -> str:
    """Return what a pause of an hour leaves of the time left, which the page counts once a second."""
    pass_an_hour(browser)
    browser.evaluate("new Promise(done => setTimeout(done, 1200))")
    return text(browser, "#left")


def pause_and_answer(browser: Browser, done: int) -> None:
    """Ask for a pause while a question is asked: it comes once this is answered, before the run."""
    browser.press("[data-action=pause]")
    browser.wait_for(seen("#said", "It pauses before the next run"))
    browser.press("#ask-form [type=submit]")
    browser.wait_for(seen("#word", "is paused") + " && " + seen("#counts", f"{done} of 15 runs done"))
    browser.wait_for(f"[...document.querySelectorAll('#rows tr.done')].length === {done}")


def see_what_is_asked_first(browser: Browser) -> None:
    """See the first question; a telephone that writes 11,8 shows all its keys: beside its digits it has no point."""
    browser.wait_for(seen("#ask", "swap the battery"))
    assert "Next is r_1: Task" in text(browser, "#ask-run")
    assert browser.evaluate("document.getElementById('answer-0').inputMode") == "decimal"
    browser.call("Emulation.setLocaleOverride", locale="it-IT")
    browser.evaluate("location.reload()")
    browser.wait_for("document.getElementById('answer-0')?.inputMode === 'text'")
    browser.call("Emulation.setLocaleOverride")


@pytest.mark.long
def test_a_person_with_a_phone_follows_pauses_answers_and_continues_the_demo(
    browser: Browser, serve_page: Callable[..., ServedPage], executed_demo: Path, tmp_path: Path
) -> None:
    demo = next(executed_demo.rglob("demo.py")).read_text(encoding="utf-8")
    demo = demo.replace("    operation_type = OperationType.AUTO\n", STEP)
    demo = demo.replace("OperationType, RunTableModel", "OperationType, OperatorStep, Question, RunTableModel")
    config = tmp_path / "demo.py"
    config.write_text(demo, encoding="utf-8")
    root = tmp_path / "basic_experiment"
    with executed(config, "--only", "r_1,r_2,r_3") as experiment:
        wait_until(lambda: any(read_journal(root / "journal.jsonl", kinds={"waiting"})))
        page = serve_page(tmp_path)
        browser.open(page.links["Here"], **PHONE)
        browser.wait_for(seen(".experiment-item.waiting", "Waits for you: swap the battery"))
        assert "key" not in browser.evaluate("location.href"), "the key stays in the address"
        browser.press(".experiment-item a")
        see_what_is_asked_first(browser)
        # What is not taken is said beside its question, and the first of them has the focus.
        browser.press("#answer-0")
        browser.write("118")
        browser.press("#ask-form [type=submit]")
        browser.wait_for(seen("#error-0", "118 is above 13 V"))
        assert "The question is not answered" in text(browser, "#error-1")
        browser.evaluate("document.getElementById('answer-0').select()")
        browser.write("11.8")
        browser.press("#answer-1-0")
        for run, done in (("r_1", 0), ("r_2", 1), ("r_3", 2)):
            if run != "r_1":
                title = "swap the battery" if run == "r_3" else f"May {run} start"
                browser.wait_for(seen("#ask", f"{title}[^]*{run}"))
            if run == "r_3":
                browser.press("#answer-0")
                browser.write("11.2")
                browser.press("#answer-1-1")
            pause_and_answer(browser, done)
            if done == 1:
                assert browser.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
                assert re.search("(?:about|at least) (?!0 s)[0-9]+ .*left", left_an_hour_later(browser))
            browser.press("[data-action=end-pause]")
            browser.wait_for(seen("#ask", f"lift the robot[^]*This is about {run}: Task"))
            browser.press("#ask-form [type=submit]")
        assert experiment.wait(timeout=60) == 0
        browser.wait_for(seen("#word", "nobody executes it") + " && " + seen("#means-table", "Computation"))
        wait_for_whole_samples(browser, "r_3")
        # A run that is chosen shows its samples, and its way.
        browser.press("button.run[data-run=r_1]")
        browser.wait_for(seen("#curves", "Samples of r_1"))
        browser.wait_for(
            "document.querySelectorAll('#plots canvas').length >= 2 && document.querySelector('#map .way')"
        )
    steps = list(read_journal(root / "journal.jsonl", kinds={"operator_step"}))
    assert [each["answers"] for each in steps if not each.get("is_after")] == [
        {"voltage": 11.8, "dock": "A"},
        {"voltage": 11.2, "dock": "B"},
    ]
    assert [each["run"] for each in steps if each.get("is_after")] == ["r_1", "r_2", "r_3"]
    assert {"paused", "continued"} <= {each["kind"] for each in read_journal(root / "journal.jsonl")}
    refused = [event for event in browser.complaints if "422" not in str(event)]
    assert refused == []
    assert all(url.startswith(f"http://127.0.0.1:{page.port}/") for url in browser.requests if "blob:" not in url)


SIDE_BY_SIDE = """
from robot_runner import ExperimentConfig, Factor, RunTableModel

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "side_by_side"
    results_output_path = "."
    workers = 2
    claims = []

    def launch_mission(self, context):
        from pathlib import Path
        import time
        task = context.combination["Task"]
        print(f"this is the log of {task}", flush=True)
        (context.run_folder / "samples.csv").write_text(f"time_s,{task}_W\\n0,1\\n1,2\\n")
        while not (Path(__file__).parent / "enough").exists():
            time.sleep(0.05)

    def create_run_table(self):
        return RunTableModel([Factor("Task", ["video", "audio"])], data_columns=[])
"""


@pytest.mark.long
def test_of_two_runs_in_flight_a_viewer_chooses_whose_log_and_samples_are_shown(
    browser: Browser, serve_page: Callable[..., ServedPage], tmp_path: Path
) -> None:
    config = tmp_path / "side_by_side.py"
    config.write_text(SIDE_BY_SIDE, encoding="utf-8")
    with executed(config) as experiment:
        root = tmp_path / "side_by_side"
        wait_until(lambda: len(list(root.glob("current_log*.txt"))) == 2)
        page = serve_page(root)
        browser.open(page.links["Here"])
        browser.wait_for(seen("#log", "Log of r_1") + " && " + seen("#log-text", "the log of video"))
        browser.wait_for(seen("#curves", "video W"))
        browser.press("[data-watch=r_2]")
        browser.wait_for(seen("#log", "Log of r_2") + " && " + seen("#log-text", "the log of audio"))
        browser.wait_for(seen("#curves", "audio W"))
        browser.wait_for("document.querySelector('[data-watch=r_2]').getAttribute('aria-pressed') === 'true'")
        assert browser.evaluate("document.querySelector('[data-watch=r_1]').getAttribute('aria-pressed')") == "false"
        (tmp_path / "enough").touch()
        assert experiment.wait(timeout=60) == 0
        browser.wait_for(seen("#counts", "2 of 2 runs done"))
    assert browser.complaints == []


#: Each answer with samples is held back, as a slow network would, until `letThrough` is called.
HOLDING_BACK = """(() => {
  const asked = window.fetch;
  const through = new Promise((done) => { window.letThrough = done; });
  window.held = 0;
  window.fetch = async (address, options) => {
    const answer = await asked(address, options);
    if (String(address).includes('/curves/')) { window.held += 1; await through; }
    return answer;
  };
})()"""


@pytest.mark.long
def test_a_run_that_ended_while_the_rows_were_fetched_is_shown_as_it_ended(
    browser: Browser, serve_page: Callable[..., ServedPage], write_config: Callable[..., Path], tmp_path: Path
) -> None:
    config = write_config(
        "def launch_mission(self, context):\n"
        "    while not Path('go').exists(): context.clock.sleep(0.02)\n"
        "def populate_run_data(self, context): return {'Energy': 1.5}"
    )
    page = serve_page(tmp_path)
    browser.open(page.links["Here"])
    browser.evaluate(HOLDING_BACK.replace("/curves/", "/rows?"))
    with executed(config, "--only", "r_1") as experiment:
        browser.wait_for("document.querySelector('.experiment-item a')")
        browser.press(".experiment-item a")
        browser.wait_for(seen("#flight-list", "r_1") + " && window.held > 0")
        (tmp_path / "go").touch()
        assert experiment.wait(timeout=60) == 0
        browser.wait_for(seen("#counts", "1 of 4 runs done"))
        browser.evaluate("window.letThrough()")
        browser.wait_for("document.querySelector('#rows tr.done')", seconds=10)


@pytest.mark.long
def test_samples_of_a_run_that_ended_before_its_first_ones_had_arrived_are_looked_at_once_more(
    browser: Browser, serve_page: Callable[..., ServedPage], write_config: Callable[..., Path], tmp_path: Path
) -> None:
    config = write_config(
        "def launch_mission(self, context):\n"
        "    (context.run_folder / 'a.csv').write_text('time_s,early_W\\n0,1\\n1,2\\n')\n"
        "    while not Path('go').exists(): context.clock.sleep(0.02)\n"
        "    (context.run_folder / 'b.csv').write_text('time_s,late_W\\n0,1\\n1,2\\n')\n"
        "def populate_run_data(self, context): return {'Energy': 1.5}"
    )
    root = tmp_path / "results" / "trial"
    page = serve_page(tmp_path)
    browser.open(page.links["Here"])
    browser.evaluate(HOLDING_BACK)
    with executed(config, "--only", "r_1") as experiment:
        browser.wait_for("document.querySelector('.experiment-item a')")
        browser.press(".experiment-item a")
        browser.wait_for("window.held === 1")
        (tmp_path / "go").touch()
        assert experiment.wait(timeout=60) == 0
        browser.wait_for(seen("#word", "nobody executes it"))
        browser.evaluate("window.letThrough()")
        browser.wait_for(seen("#curve-choice", "early W[^]*late W"))
    assert {each["run"] for each in read_journal(root / "journal.jsonl", kinds={"attempt_finished"})} == {"r_1"}
    assert browser.complaints == []


@pytest.mark.long
def test_a_run_that_was_chosen_while_it_is_executed_goes_on_being_shown(
    browser: Browser, serve_page: Callable[..., ServedPage], write_config: Callable[..., Path], tmp_path: Path
) -> None:
    config = write_config(
        "def launch_mission(self, context):\n"
        "    (context.run_folder / 'a.csv').write_text('time_s,power_W\\n5000,1\\n')\n"
        "    while not Path('on').exists(): context.clock.sleep(0.02)\n"
        "    with (context.run_folder / 'a.csv').open('a') as file: file.write('5001,2\\n')\n"
        "    while not Path('go').exists(): context.clock.sleep(0.02)\n"
        "    with (context.run_folder / 'a.csv').open('a') as file: file.write('5002,3\\n')\n"
        "def populate_run_data(self, context): return {'Energy': 1.5}"
    )
    root = tmp_path / "results" / "trial"
    with executed(config, "--only", "r_1") as experiment:
        wait_until(lambda: any(read_journal(root / "journal.jsonl", kinds={"attempt_started"})))
        page = serve_page(root)
        browser.open(page.links["Here"])
        browser.wait_for(seen("#plots", "last 1 at 0 s") + " && document.querySelector('button.run[data-run=r_1]')")
        browser.evaluate("document.querySelector('button.run[data-run=r_1]').click()")
        browser.wait_for("document.querySelector('button.run[data-run=r_1]').getAttribute('aria-pressed') === 'true'")
        (tmp_path / "on").touch()
        browser.wait_for(seen("#plots", "last 2 at 1 s"))
        (tmp_path / "go").touch()
        assert experiment.wait(timeout=60) == 0
        browser.wait_for(seen("#plots", "last 3 at 2 s"))
    # And where it is executed again.
    for name in ("on", "go"):
        (tmp_path / name).unlink()
    with executed(config, "--redo", "r_1", "--only", "r_1") as experiment:
        browser.wait_for(seen("#plots", "last 1 at 0 s"))
        for name in ("on", "go"):
            (tmp_path / name).touch()
        assert experiment.wait(timeout=60) == 0
    assert browser.complaints == []


def test_who_may_only_look_has_no_buttons(
    browser: Browser, serve_page: Callable[..., ServedPage], write_config: Callable[..., Path], tmp_path: Path
) -> None:
    config = write_config("def launch_mission(self, context): context.clock.sleep(600)")
    with executed(config):
        root = tmp_path / "results" / "trial"
        wait_until(lambda: any(read_journal(root / "journal.jsonl", kinds={"attempt_started"})))
        page = serve_page(root)
        browser.open(page.links["To look"])
        browser.wait_for(seen("#flights", "on its mission"))
        assert browser.evaluate("document.querySelectorAll('#actions button').length") == 0
        # Somebody else logs in, in the same browser, and stops it.
        browser.open("about:blank")
        browser.open(page.links["Here"])
        browser.wait_for("document.querySelector('[data-action=stop]')")
        browser.press("[data-action=stop]")
        browser.wait_for("document.getElementById('dialog').open")
        assert "r_1 is closed, the robot is made safe" in text(browser, "#dialog-text")
        browser.press("#dialog-yes")
        browser.wait_for(seen("#word", "nobody executes it"))
    kinds = [each["kind"] for each in read_journal(root / "journal.jsonl")]
    assert kinds.count("stop_requested") == 1
    assert kinds[-1] == "experiment_finished"


@pytest.mark.long
def test_a_page_goes_on_after_its_server_was_started_anew(
    browser: Browser, serve_page: Callable[..., ServedPage], write_config: Callable[..., Path], tmp_path: Path
) -> None:
    config = write_config(
        "def launch_mission(self, context):\n    while not Path('go').exists(): context.clock.sleep(0.02)\n"
        "def populate_run_data(self, context): return {'Energy': 1.5}"
    )
    root = tmp_path / "results" / "trial"
    with executed(config) as experiment:
        wait_until(lambda: any(read_journal(root / "journal.jsonl", kinds={"attempt_started"})))
        page = serve_page(root)
        browser.open(page.links["Here"])
        browser.wait_for(seen("#word", "is running"))
        page.stop()
        browser.wait_for(seen("#link", "connection lost"))
        (tmp_path / "go").touch()
        assert experiment.wait(timeout=60) == 0  # it did not notice
        page.start()
        browser.wait_for(seen("#word", "all runs are done"))
        browser.wait_for("document.querySelectorAll('#rows tr.done').length === 4")
        assert text(browser, "#link") == "live"


@pytest.mark.long
def test_an_open_page_shows_what_another_server_serves_at_its_address(
    browser: Browser, serve_page: Callable[..., ServedPage], tmp_path: Path
) -> None:
    make_large(tmp_path / "first" / "one", 3)
    make_large(tmp_path / "second", 5)
    page = serve_page(tmp_path / "first")
    browser.open(page.links["Here"])
    browser.wait_for(seen(".experiment-item a", "large"))
    browser.press(".experiment-item a")
    browser.wait_for(seen("#counts", "3 of 3 runs done"))
    browser.press("#share")
    assert browser.evaluate("document.getElementById('dialog').open")
    # As by `run --page`, of one experiment after the other.
    page.stop()
    browser.wait_for(seen("#link", "connection lost"))
    page.folder, page.words = tmp_path / "second", ("--read-only",)
    page.start()
    browser.wait_for(seen("#counts", "5 of 5 runs done") + " && " + seen("#link", "live"))
    assert not browser.evaluate("document.getElementById('dialog').open"), "what it asks is of another experiment"
    # And what is no longer there is said.
    page.stop()
    page.folder = tmp_path / "first"
    page.start()
    browser.wait_for(seen(".experiment-item a", "large"))
    browser.press(".experiment-item a")
    browser.wait_for(seen("#counts", "3 of 3 runs done"))
    page.stop()
    (tmp_path / "first" / "one").rename(tmp_path / "first" / "renamed")
    page.start()
    browser.wait_for(seen("#notice", "There is no such experiment") + " && " + seen(".experiment-item", "renamed"))
    browser.press(".experiment-item a")
    browser.wait_for(seen("#counts", "3 of 3 runs done") + " && document.getElementById('notice').hidden")


@pytest.mark.long
def test_a_server_that_is_silent_is_not_told_as_live(
    browser: Browser, serve_page: Callable[..., ServedPage], tmp_path: Path
) -> None:
    make_large(tmp_path / "large", 3)
    page = serve_page(tmp_path / "large")
    browser.open(page.links["Here"])
    browser.wait_for(seen("#counts", "3 of 3 runs done"))
    assert page.process is not None
    page.process.send_signal(signal.SIGSTOP)  # as a laptop that sleeps, or a network that is gone
    try:
        pass_an_hour(browser)
        browser.wait_for(seen("#link", "connection lost"))
    finally:
        page.process.send_signal(signal.SIGCONT)
    browser.wait_for(seen("#link", "live"))


@pytest.mark.long
def test_a_tab_that_nobody_sees_keeps_no_connection_of_the_few_that_a_browser_has(
    browser: Browser, serve_page: Callable[..., ServedPage], tmp_path: Path
) -> None:
    make_large(tmp_path / "large", 3)
    page = serve_page(tmp_path / "large")

    def viewers() -> str:
        return page.ask("/metrics").body.decode().rpartition("robot_runner_viewers ")[2].strip()

    def is_hidden(is_hidden: str) -> None:
        browser.evaluate(f"Object.defineProperty(document, 'hidden', {{value: {is_hidden}, configurable: true}})")
        browser.evaluate("document.dispatchEvent(new Event('visibilitychange'))")

    quick = browser.call(
        "Page.addScriptToEvaluateOnNewDocument",
        source="{ const later = setTimeout; window.setTimeout = (then, ms) => later(then, ms / 20); }",
    )
    try:
        browser.open(page.links["Here"])
        browser.wait_for(seen("#counts", "3 of 3 runs done"))
        is_hidden("true")
        wait_until(lambda: viewers() == "0")
        # Its title is kept up to date all the same.
        manifest = (tmp_path / "large" / "manifest.json").read_text()
        (tmp_path / "large" / "manifest.json").write_text(manifest.replace('"large"', '"other"'))
        with (tmp_path / "large" / "journal.jsonl").open("a") as journal:
            journal.write('{"kind":"finding","run":"r_1","owner":"x","problem":"odd","fix":""}\n')
        browser.wait_for("document.title.startsWith('other')")
        is_hidden("false")
        wait_until(lambda: viewers() == "1")
        browser.wait_for(seen("#findings", "odd"))
    finally:
        browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=quick["identifier"])


@pytest.mark.long
def test_how_long_a_run_goes_on_is_told_by_the_clock_of_the_experiment(
    browser: Browser, serve_page: Callable[..., ServedPage], write_config: Callable[..., Path], tmp_path: Path
) -> None:
    config = write_config("def launch_mission(self, context): context.clock.sleep(600)")
    root = tmp_path / "results" / "trial"
    with executed(config):
        wait_until(lambda: any(read_journal(root / "journal.jsonl", kinds={"attempt_started"})))
        page = serve_page(root)
        wrong = browser.call(
            "Page.addScriptToEvaluateOnNewDocument", source="Date.now = () => Date.parse('2050-01-01')"
        )
        try:
            browser.open(page.links["Here"])
            browser.wait_for(seen("#flight-list [data-since]", "^for [0-9]+ (s|min)"))
        finally:
            browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=wrong["identifier"])


def make_large(root: Path, runs: int) -> None:
    """Write the experiment of many runs that are done, as it is on disk."""
    root.mkdir(parents=True)
    (root / "manifest.json").write_text(json.dumps({"format": 1, "experiment_name": "large", "design": {}, "seed": 1}))
    fields = [("run_id", "progress", "string"), ("status", "progress", "string"), ("Task", "factor", "string")]
    fields += [("Energy", "measure", "number")]
    schema = {
        "fields": [{"name": n, "type": t, "robot_runner:role": r, "robot_runner:owner": ""} for n, r, t in fields]
    }
    (root / "run_table.schema.json").write_text(json.dumps(schema))
    lines = [f"r_{place + 1},Done,{'ABC'[place % 3]},{700 + place % 7}" for place in range(runs)]
    (root / "run_table.csv").write_text("\n".join(["run_id,status,Task,Energy", *lines]) + "\n")
    records = [{"kind": "experiment_started", "at": "2026-01-31T12:00:00.000Z", "runs": runs}]
    (root / "journal.jsonl").write_text("".join(f"{json.dumps(each, separators=(',', ':'))}\n" for each in records))


@pytest.mark.long
def test_10000_runs_are_shown_soon_and_scrolled_smoothly(
    browser: Browser,
    serve_page: Callable[..., ServedPage],
    tmp_path: Path,
    record_property: Callable[[str, object], None],
) -> None:
    make_large(tmp_path / "large", 10_000)
    page = serve_page(tmp_path / "large")
    browser.open(page.links["Here"])
    browser.wait_for("document.querySelectorAll('#rows tr.done').length > 5")
    spent = browser.evaluate("performance.now()")
    record_property("figure", f"10,000 runs are shown {spent / 1000:.2f} s after the page was asked for")
    assert int(browser.evaluate("document.getElementById('rows').getAttribute('aria-rowcount')")) == 10_001
    browser.evaluate("document.getElementById('scroller').scrollTop = 5000 * 34")
    browser.wait_for("document.querySelector('button.run[data-run=r_5001]')")
    assert browser.evaluate("document.querySelectorAll('#rows tbody tr').length") < 80, "rows that nobody sees"
    browser.evaluate("document.getElementById('search').value = 'r_999'")
    browser.evaluate("document.getElementById('search').dispatchEvent(new Event('input'))")
    browser.wait_for(seen("#found", "^11 runs"))
    browser.wait_for("document.querySelectorAll('#rows tr.done').length === 11")
    assert browser.complaints == []


@pytest.mark.long
@pytest.mark.parametrize("window", soak_but([PHONE], [{"width": 1280}, PHONE]), ids=["desk", "phone"])
def test_means_are_in_sight_where_a_treatment_is_a_long_word(
    browser: Browser, serve_page: Callable[..., ServedPage], tmp_path: Path, window: dict[str, int]
) -> None:
    make_large(tmp_path / "long", 6)
    table = (tmp_path / "long" / "run_table.csv").read_text()
    (tmp_path / "long" / "run_table.csv").write_text(table.replace(",A,", f",{'0123456789abcdef' * 10},"))
    browser.open(serve_page(tmp_path / "long").links["Here"], **window)
    browser.wait_for(seen("#means-table", "0123456789abcdef"))
    assert browser.evaluate("document.documentElement.scrollWidth") <= window["width"]
    ends = "[...document.querySelectorAll('#means-table td')].map(each => each.getBoundingClientRect().right)"
    assert max(browser.evaluate(ends)) <= browser.evaluate(
        "document.getElementById('means').getBoundingClientRect().right"
    )
    names = "[...document.querySelectorAll('#means-table tbody th')].map(each => each.clientWidth)"
    assert min(browser.evaluate(names)) >= 100, "a name of usual length is broken"


HOSTILE = "<img src=x onerror=alert(1)>\"'</script>"


@pytest.mark.long
def test_hostile_names_are_text(browser: Browser, serve_page: Callable[..., ServedPage], tmp_path: Path) -> None:
    root = tmp_path / "<b onclick=alert(1)>x"
    make_large(root, 3)
    manifest = json.loads((root / "manifest.json").read_text()) | {"experiment_name": HOSTILE + "\x1b[2J\u202egnp"}
    (root / "manifest.json").write_text(json.dumps(manifest))
    table = (root / "run_table.csv").read_text().replace(",A,", ',"' + HOSTILE.replace('"', '""') + '",')
    (root / "run_table.csv").write_text(table.replace(",701", ",9999.97").replace(",702", ",-1.5e-09"))
    finding = {"kind": "finding", "run": HOSTILE, "owner": HOSTILE, "problem": HOSTILE, "fix": HOSTILE}
    with (root / "journal.jsonl").open("a") as file:
        file.write(json.dumps(finding, separators=(",", ":")) + '\n{"kind":"event","at":5}\nnot json\n')
    (root / "report").mkdir()
    (root / "report" / "report.html").write_text(
        "<title>r</title><script>try { document.title = document.cookie || 'none' }"
        "catch (e) { document.title = 'shut' }"
        "fetch('/api/about').then(() => { document.title = 'asked' }, () => {})</script>"
    )
    page = serve_page(tmp_path)
    browser.open(page.links["Here"])
    browser.wait_for("document.querySelector('.experiment-item a')")
    browser.press(".experiment-item a")
    browser.wait_for(seen("#findings", "onerror"))
    browser.wait_for(seen("#rows", "onerror"))
    browser.wait_for(seen("#told", "2 lines of the journal are damaged"))
    assert "\t10000\n" in text(browser, "#rows"), "a number is not rounded to 1.000e+4"
    as_in_reports = "\N{MINUS SIGN}1.500\N{MULTIPLICATION SIGN}10\N{SUPERSCRIPT MINUS}\N{SUPERSCRIPT NINE}"
    assert f"\t{as_in_reports}" in text(browser, "#rows")
    assert browser.evaluate("document.querySelectorAll('main img[src=x], main b, [onclick]').length") == 0
    assert text(browser, "#title").startswith("<img src=x")
    assert browser.complaints == []
    # Its report has no origin: it reads no cookie and asks the server for nothing.
    browser.open(browser.evaluate("document.querySelector('#actions a').href"))
    browser.wait_for("document.title === 'shut'")
    assert browser.evaluate("self.origin") == "null"


CONTRAST = """(() => {
  const shade = (colour) => {
    const c = document.createElement('canvas').getContext('2d');
    c.fillStyle = colour;
    c.fillRect(0, 0, 1, 1);
    return [...c.getImageData(0, 0, 1, 1).data];
  };
  const linear = (v) => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = (rgb) => [0.2126, 0.7152, 0.0722].reduce((sum, share, i) => sum + share * linear(rgb[i] / 255), 0);
  const behind = (e) => {
    for (; e; e = e.parentElement) {
      const c = shade(getComputedStyle(e).backgroundColor);
      if (c[3] > 250) { return c; }
    }
    return [255, 255, 255];
  };
  const hasText = (e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
  return [...document.querySelectorAll('body *')].filter((e) => e.offsetParent && hasText(e)).filter((e) => {
    const [one, other] = [light(shade(getComputedStyle(e).color)), light(behind(e))].sort((a, b) => b - a);
    return (one + 0.05) / (other + 0.05) < 4.5;
  }).map((e) => e.tagName + ' ' + e.textContent.slice(0, 30));
})()"""
#: What has no name for a screen reader, ids that are there twice, and tables whose headings have no scope.
NAMELESS = """(() => {
  const all = (selector) => [...document.querySelectorAll(selector)];
  const named = (e) => e.textContent.trim() || e.getAttribute('aria-label') || (e.labels && e.labels.length)
    || e.getAttribute('aria-labelledby');
  const said = (e) => (e.getAttribute('aria-labelledby') || e.getAttribute('aria-describedby')).split(' ');
  return [
    ...all("button, a, input, select, [role=img], [role=region]").filter((e) => e.offsetParent && !named(e)),
    ...all('th').filter((e) => !e.scope),
    ...all('[id]').filter((e) => all('#' + CSS.escape(e.id)).length > 1),
    ...all('[aria-labelledby], [aria-describedby]').filter((e) => said(e).some((id) => !document.getElementById(id))),
  ].map((e) => e.outerHTML.slice(0, 80));
})()"""


@pytest.mark.long
@pytest.mark.parametrize("is_dark", soak_but([True], [False, True]), ids=["light", "dark"])
def test_it_is_legible_and_can_be_used_by_keyboard(
    browser: Browser, serve_page: Callable[..., ServedPage], executed_demo: Path, *, is_dark: bool
) -> None:
    root = next(executed_demo.rglob("journal.jsonl")).parent
    page = serve_page(root)
    browser.is_dark(is_dark)
    try:
        browser.open(page.links["Here"])
        browser.wait_for("document.querySelectorAll('#rows tr.done').length > 5")
        assert (browser.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(18, 22, 27)") is is_dark
        reached: list[str] = []
        for _ in range(40):
            browser.key("Tab", 9)
            reached.append(browser.evaluate("document.activeElement.id || document.activeElement.dataset.run || ''"))
            if reached[-1] == "r_2":
                break
        assert [each for each in reached if re.fullmatch("share|scheme|status|search|follow|r_1", each)] == [
            "share",
            "scheme",
            "status",
            "search",
            "follow",
            "r_1",
        ]
        browser.key("Enter", 13)
        browser.wait_for(seen("#curves", "Samples of r_2"))
        assert browser.evaluate("document.activeElement.dataset.run") == "r_2", "the focus is lost when rows are drawn"
        assert browser.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
        assert browser.evaluate(CONTRAST) == []
        assert browser.evaluate(NAMELESS) == []
        assert browser.inaccessible() == []
        assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
    finally:
        browser.is_dark(False)
