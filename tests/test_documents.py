"""Every command that README and documents show is run in the order in which a reader meets it, or listed with a reason.

Each page is walked in an empty directory in which the repository lies beside what the page says that the reader has.
What takes hours there is run with small settings. All pages together are slow; what a page shows along with its output
is compared in every run of the tests.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mujoco
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer

from legtool.cli import COMMANDS, GROUPS
from legtool.command import call, parse
from legtool.configs.robots import load_robot
from legtool.configs.sweep import SweepSettings
from legtool.pipeline.sweep import collect_sweep
from legtool.sim.robots.robot import add_robot

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    "README.md",
    *(f"docs/{name}.md" for name in ("index", "tutorial", "your_robot", "your_controller", "faq", "glossary")),
    *(f"docs/{name}.md" for name in ("logs", "motion", "foothold", "steppability", "planner", "quadpips", "arena")),
    *(f"docs/{name}.md" for name in ("replay", "cluster", "bundle_format", "architecture", "limitations")),
    *(f"docs/{name}.md" for name in ("security", "citing")),
    "runtime/README.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
)
#: What a shown command begins with; other lines of a listing are no commands.
PROGRAMS = ("legtool", "srun", "python", "pip", "make", "pytest", "sed", ".")

#: Words that stand for the reader's own, and what stands in their place.
OWN = {
    "BUNDLE": "bundle", "DIR": "out", "LOG...": "walk.mcap", "PATH": "walk.mcap",
    "ROBOT": "aliengo", "TOPICS": "ros2_standard",
}  # fmt: skip
#: What is said in addition, so that a command takes minutes at most: the first entry that fits, by what it begins with.
_SHORT = ["--set", "timeout_s=3", "--trials", "1", "--films", "0", "--workers", "1"]
SMALL: tuple[tuple[str, list[str]], ...] = (
    ("legtool collect sweep", ["--set", "episodes=3", "--set", "episode_s=30"]),
    ("legtool collect footholds", ["--samples", "300"]),
    ("legtool collect scenes", ["--scenes", "10", "--frames", "2"]),
    ("legtool train vfa", ["--set", "epochs=1"]),
    ("legtool train vpa", ["--set", "epochs=1"]),
    ("legtool train steppability", ["--set", "epochs=1", "--set", "coarse_epochs=0"]),
    ("legtool eval vfa", ["--set", "vfa_samples=200"]),
    ("legtool eval vpa vpa", ["--set", "vpa_samples=50"]),
    ("legtool eval vpa --suite vital", ["--set", "walks=[stairs]"]),
    ("legtool eval planner --suite tracking", ["--suite", "course:stones_trot:3", *_SHORT]),
    ("legtool eval planner --suite vital", ["--suite", "vital_stairs", "--planners", "vital", *_SHORT]),
    ("legtool eval planner --suite quadpips", ["--suite", "ramp", *_SHORT]),
    ("legtool eval planner --suite sparse_stepping_stones", _SHORT),
    ("legtool eval planner --bundle bundle --suite gap_10 --planners velocity", ["--set", "timeout_s=6"]),
    ("legtool eval planner", ["--horizons", "3", *_SHORT]),
    ("legtool eval perception", ["--sequences", "1"]),
    ("python benchmarks/pose_solver.py 3000", []),
)  # fmt: skip
#: Commands that are run in another form.
INSTEAD = {
    "python benchmarks/pose_solver.py 3000": "python benchmarks/pose_solver.py 20",
    "python benchmarks/foothold.py [--bundle BUNDLE ...]": "python benchmarks/foothold.py",
}
#: Commands that are not run, and why.
NOT_RUN = {
    "make demo": "the demo has a test of its own, tests/test_cli.py",
    "make test": "it is what runs this",
    "make check": "it is run before every change lands, by .ci/run",
    "make slow": "it is what runs this",
    "make docs": "tests/test_site.py builds the site",
    ". .venv/bin/activate": "whoever runs this has done so",
    "pip install ./runtime": "make check installs the wheel elsewhere, and runs the tests of the runtime",
    "pytest": "slow tests are run by make slow",
    "srun ": "it needs a cluster with SLURM; tests/pipeline/test_shards.py runs shards",
    "pip install 'legtool[cluster]'": "dev, with which tests run, has it",
    "legtool collect sweep --robot go2 --out /shared/sweep --cluster": "it needs machines; a local cluster is run",
    "python benchmarks/": "speed is measured on an idle machine",
    "legtool eval planner --suite arena": "it needs two policies that are not ours to give, and days",
}
#: Of these pages, what needs the real data beside the repository.
REAL = {"real_continuous.csv": "aliengo/real_continuous.csv", "policy.yaml": "controllers/aliengo_policy/policy.onnx"}


class Shown(NamedTuple):
    """A command as a page shows it.

    Attributes:
        page: where.
        line: at which line.
        text: the command line, without its comment.
        said: what the page says that it prints; None where it does not say.
    """

    page: str
    line: int
    text: str
    said: tuple[str, ...] | None

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"


def commands_of(page: str) -> list[Shown]:
    """The commands of a page, in order: fenced as bash or console, or indented."""
    found: list[Shown] = []
    fence, before = None, ""
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    number = 0
    while number < len(lines):
        first, line = number, lines[number]
        number += 1
        opened = re.match(r"\s*```\{?([\w-]*)", line)
        if opened:
            fence = None if fence is not None else opened.group(1)
            before = line
            continue
        shown = line[4:] if fence is None and line.startswith("    ") and not before.strip() else line
        text = shown.removeprefix("$ ")
        is_command = text.split(" ", 1)[0] in PROGRAMS and " " in text
        if fence == "console" and not shown.startswith("$ "):
            last = found[-1]
            found[-1] = last._replace(said=(*(last.said or ()), line))
        elif is_command and (fence in ("bash", "console") or (fence is None and shown is not line)):
            while text.endswith("\\"):
                text = text[:-1].rstrip() + " " + lines[number].strip()
                number += 1
            for part in _without_comment(text).split(" && "):
                found.append(Shown(page, first + 1, part.strip(), None))
        if fence is not None or not line.startswith("    "):
            before = line
    return found


def _without_comment(text: str) -> str:
    """A comment begins with a # after white space, outside of quotes."""
    return re.sub(r"""((?:[^'"#]|'[^']*'|"[^"]*")*?)\s#.*$""", r"\1", text).strip()


def everything() -> list[Shown]:
    """The commands of all pages."""
    return [shown for page in PAGES for shown in commands_of(page)]


def reason(shown: Shown) -> str | None:
    """Why it is not run; None where it is."""
    if shown.text in INSTEAD:
        return None
    return next((why for begin, why in NOT_RUN.items() if shown.text.startswith(begin)), None)


def to_run(shown: Shown) -> str:
    """The command line that is run: the reader's own words filled in, small settings added."""
    if shown.text in INSTEAD:
        return INSTEAD[shown.text]
    words = [OWN.get(word, word) for word in shown.text.split(" ")]
    more = next((extra for begin, extra in SMALL if shown.text.startswith(begin)), [])
    return " ".join([*words, *(shlex.quote(word) for word in more)])


def test_all_documents_are_among_the_pages_and_show_commands() -> None:
    written = {str(path.relative_to(ROOT)) for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"))}
    assert written - {"CHANGELOG.md"} == {page for page in PAGES if "/" not in page or page.startswith("docs/")}
    assert len(everything()) > 60
    assert any(shown.said for shown in commands_of("docs/faq.md"))


def test_every_line_of_the_tables_is_used() -> None:
    texts = [shown.text for shown in everything()]
    for begin in (*NOT_RUN, *INSTEAD):
        assert any(text.startswith(begin) for text in texts), begin
    for word in OWN:
        assert any(word in text.split() for text in texts) or word == "DIR", word


def test_every_command_of_legtool_is_one_that_it_has() -> None:
    lines = [to_run(shown) for shown in everything() if not shown.said]
    lines += [text for page in PAGES for text in re.findall(r"`(legtool [a-z][^`]+)`", (ROOT / page).read_text())]
    checked = set()
    for line in lines:
        words = shlex.split(line)[1:]
        for command in COMMANDS:
            name = command.name.split()
            if words[: len(name)] == name and len(words) > len(name):  # a name alone is no call of it
                parse(COMMANDS, GROUPS, words)
                checked.add(command.name)
    assert {
        "collect sweep",
        "collect log",
        "train vfa",
        "eval planner",
        "eval vpa",
        "export",
        "info",
        "replay",
    } <= checked


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty directory in which the repository's own folders lie, as in a clone; commands are run here."""
    for name in ("benchmarks", "docs", "examples", "legtool", "runtime"):
        (tmp_path / name).symlink_to(ROOT / name)
    programs = tmp_path / ".programs"
    programs.mkdir()
    for name, module in (("legtool", "-m legtool"), ("python", "")):
        (programs / name).write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {module} "$@"\n')
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(ROOT / "runtime" / "src")]))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said_pages() -> list[str]:
    return [page for page in PAGES if any(shown.said is not None for shown in commands_of(page))]


@pytest.mark.parametrize("page", said_pages())
def test_what_a_page_shows_is_what_a_command_prints(page: str, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Run in this process: they are mistakes, that are told at once."""
    (place / "copied").mkdir()
    for shown in commands_of(page):
        if shown.said is None and not shown.text.startswith("sed"):
            continue
        words = shlex.split(shown.text)
        if shown.said is None:
            subprocess.run(shown.text, shell=True, check=True)
            continue
        call(COMMANDS, GROUPS, words[1:])
        printed = capsys.readouterr()
        lines = [line.rstrip() for line in (printed.out + printed.err).splitlines() if line.strip()]
        expected = [line for line in shown.said if line.strip()]
        assert len(lines) == len(expected) and all(map(_fits, expected, lines)), f"{shown}\n" + "\n".join(lines)


def _fits(expected: str, printed: str) -> bool:
    """Whether a line is the one that is shown, in which … stands for anything."""
    pattern = ".*".join(re.escape(part) for part in expected.rstrip().split("…"))
    return re.fullmatch(pattern, printed) is not None


# What readers have.


def write_walk(path: Path, robot: str) -> None:
    """A recording of a robot whose topics are those of ros2_standard."""
    sweep = path.with_name(".sweep")
    collect_sweep(SweepSettings(robot=robot, episodes=1, episode_s=90, seed=5), sweep)
    (recording,) = (sweep / "recordings").glob("*.mcap")
    renamed = {"/command": "/cmd_vel"}
    with recording.open("rb") as source, path.open("wb") as target:
        writer = Writer(target)
        writer.start(profile="ros2")
        known: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.topic.startswith("/contact"):
                continue  # contact_forces would be one topic; without them full stance is told by the feet
            if channel.id not in known:
                assert schema is not None
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                topic = renamed.get(channel.topic, channel.topic)
                known[channel.id] = writer.register_channel(topic, channel.message_encoding, number)
            writer.add_message(known[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()


def write_mjcf(path: Path, robot: str) -> None:
    """An MJCF file of a robot with a preset's lengths and masses."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_robot(spec, load_robot(robot))
    spec.compile()
    path.write_text(spec.to_xml(), encoding="utf-8")


CONTROLLER = re.compile(r"```python\n# (my_controller\.py)\n(.*?)```", re.DOTALL)


@pytest.fixture
def reader(place: Path, request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Puts what a page's reader has beside the repository: a log, a model, a policy, files that the page shows."""

    def prepare(page: str) -> None:
        text = (ROOT / page).read_text(encoding="utf-8")
        if "walk.mcap" in " ".join(to_run(shown) for shown in commands_of(page) if shown.said is None):
            write_walk(place / "walk.mcap", "go2" if "replay" in page else "aliengo")
        for name, robot in (("dog.xml", "go2"), ("robot.xml", "aliengo")):
            if name in text:
                write_mjcf(place / name, robot)
        for name, body in CONTROLLER.findall(text):
            (place / name).write_text(body)
        if page == "docs/replay.md":
            shutil.copytree(ROOT / "examples" / "bundle", place / "bundle")
        for name, real in REAL.items():
            if any(name in shown.text for shown in commands_of(page)):
                data = request.getfixturevalue("shared_data") / real
                if name.endswith(".yaml"):
                    policy = yaml.safe_load((ROOT / "examples" / "policies" / "aliengo.yaml").read_text())
                    (place / name).write_text(yaml.safe_dump({**policy, "onnx": str(data)}))
                else:
                    shutil.copy(data, place / name)

    return prepare


def runnable_pages() -> list[str]:
    return [page for page in PAGES if any(reason(one) is None and one.said is None for one in commands_of(page))]


@pytest.mark.slow
@pytest.mark.parametrize("page", runnable_pages())
def test_the_commands_of_a_page_work_in_its_order(page: str, place: Path, reader: Callable[[str], None]) -> None:
    reader(page)
    for shown in commands_of(page):
        if reason(shown) is not None or shown.said is not None:
            continue
        line = to_run(shown)
        out = re.search(r"--out (\S+)", line)
        if out and (place / out[1]).is_dir() and not _same_work(line):
            shutil.rmtree(place / out[1])
        done = subprocess.run(line, shell=True, capture_output=True, text=True, check=False, timeout=1800)
        print(f"$ {line}\n{done.stdout}{done.stderr}")
        assert done.returncode == 0, f"{shown}\nrun as: {line}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"


def _same_work(line: str) -> bool:
    """Whether a command goes on with what its --out holds: an export adds figures to a bundle."""
    return line.startswith("legtool export")
