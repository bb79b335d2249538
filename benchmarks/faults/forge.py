"""Forged input of every kind: is it refused in one line of the project's own errors, soon, and is no code run?

    python benchmarks/faults/forge.py [--kinds bundle,dataset,settings,command,log] [--count 1000] [--state FILE]

Each case is drawn from (kind, seed, number) alone: a sound input is changed somewhere, its hashes are made good again,
and it is loaded. A case fails if it raises anything but the project's own errors, tells more than a line, takes longer
than 5 s of the processor, or leaves the canary that code would leave. ``--state`` keeps how far each kind has come, so
that a campaign carries on where it was stopped.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import random
import shutil
import string
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from legtool.cli import COMMANDS, GROUPS
from legtool.command import parse
from legtool.configs.log import LogSettings
from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.robots import load_geometry
from legtool.configs.settings import load
from legtool.configs.sweep import SweepSettings
from legtool.configs.topics import load_topics
from legtool.datasets.files import sha256
from legtool.datasets.logs.log import LogReader
from legtool.datasets.motion.samples import load_transitions, motion_data
from legtool.errors import LegtoolError
from legtool.info import describe
from legtool.pipeline.sweep import RECORDINGS, collect_sweep
from legtool_runtime.bundle import MANIFEST, content_sha256, load_bundle

ROOT = Path(__file__).resolve().parents[2]
LONGEST_S, LONGEST_MESSAGE = 5.0, 4000
CANARY = "forged_canary"
#: Values that stand where others are expected.
ODD: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2**31, 2**63, 10**400, -1e308, 1e-308, 1e308, 0.5, "", "a", "\0", "a\nb", "../../etc/passwd",
    "x" * 5000, "<script>alert(1)</script>", [], {}, [[]], [None], {"": None}, [1, "a", None], [0] * 1000, {"name": {}},
    "NaN", "inf",
)  # fmt: skip


class Ground(NamedTuple):
    """What sound input is made from, and where forged input is put."""

    sweep: Path
    place: Path


def substitute(value: Any, rng: random.Random) -> Any:
    """The same JSON with one value, key or length changed."""
    paths: list[tuple[Any, Any]] = []

    def walk(item: Any) -> None:
        for key in list(item) if isinstance(item, dict) else range(len(item)) if isinstance(item, list) else ():
            paths.append((item, key))
            walk(item[key])

    value = json.loads(json.dumps(value))
    walk(value)
    holder, key = rng.choice(paths)
    how = rng.random()
    if how < 0.7:
        holder[key] = rng.choice(ODD)
    elif how < 0.8:
        del holder[key]
    elif isinstance(holder, dict):
        holder[rng.choice(["x", "name", "", "0", str(key) + "_"])] = holder.pop(key)
    else:
        holder.insert(rng.randrange(len(holder) + 1), rng.choice(ODD))
    return value


def damage(data: bytes, rng: random.Random) -> bytes:
    """The same bytes cut, flipped, doubled, emptied or filled somewhere."""
    buffer = bytearray(data)
    if not buffer:
        return bytes(rng.randbytes(16))
    at, length = rng.randrange(len(buffer)), 1 << rng.randrange(12)
    how = rng.randrange(5)
    if how == 0:
        return bytes(buffer[:at])
    if how == 1:
        for _ in range(rng.choice([1, 8, 64])):
            buffer[rng.randrange(len(buffer))] ^= 1 << rng.randrange(8)
    elif how == 2:
        buffer[at:at] = buffer[at : at + length]
    elif how == 3:
        buffer[at : at + length] = rng.choice([b"\0", b"\xff"]) * length
    else:
        buffer[at : at + length] = rng.randbytes(length)
    return bytes(buffer)


def bundle(ground: Ground, rng: random.Random) -> None:
    """A bundle whose manifest or arrays were changed, and whose digests were made good again."""
    place = ground.place / "bundle"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(ROOT / "examples" / "bundle", place)
    manifest = json.loads((place / MANIFEST).read_text())
    if rng.random() < 0.25:
        (place / "motion.npz").write_bytes(_npz(place / "motion.npz", rng))
        for entry in manifest["files"]:
            path = place / entry["name"]
            entry.update(bytes=path.stat().st_size, sha256=sha256(path))
    else:
        manifest = substitute(manifest, rng)
    if isinstance(manifest, dict):
        manifest["content_sha256"] = content_sha256(manifest)
    (place / MANIFEST).write_text(json.dumps(manifest))
    loaded = load_bundle(place)
    if "motion" in loaded.lines:
        loaded.warm_up()
    describe(place)


def _npz(path: Path, rng: random.Random) -> bytes:
    if rng.random() < 0.5:
        return damage(path.read_bytes(), rng)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(sorted(members))
    members[name] = damage(members[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for key, data in members.items():
            archive.writestr(key, data)
    return out.getvalue()


def dataset(ground: Ground, rng: random.Random) -> None:
    """A dataset whose manifest or parts were changed, and whose hashes were made good again."""
    place = ground.place / "dataset"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(ground.sweep, place)
    manifest = json.loads((place / "manifest.json").read_text())
    if rng.random() < 0.5:
        part = place / rng.choice(manifest["parts"])["name"]
        part.write_bytes(damage(part.read_bytes(), rng))
        for entry in manifest["parts"]:
            entry.update(bytes=(place / entry["name"]).stat().st_size, sha256=sha256(place / entry["name"]))
    else:
        manifest = substitute(manifest, rng)
    (place / "manifest.json").write_text(json.dumps(manifest))
    describe(place)
    motion_data(load_transitions([place]).table)


def settings(ground: Ground, rng: random.Random) -> None:
    """Settings of a YAML file, or of the command line."""
    cls = rng.choice([SweepSettings, PlannerEvalSettings])
    if rng.random() < 0.5:
        values = substitute(cls().to_dict(), rng)
        text = json.dumps(values) if rng.random() < 0.5 else cls().to_yaml()
        data = damage(text.encode(), rng) if rng.random() < 0.5 else text.encode()
        if rng.random() < 0.2:
            data += f"\nblack_box: !!python/object/apply:os.system ['touch {CANARY}']\n".encode()
        path = ground.place / "settings.yaml"
        path.write_bytes(data)
        load(cls, path)
    else:
        names = [*cls.model_fields, "planner.margin_m", "controller.swing_height", "a.b.c", "", "."]
        values = [
            json.dumps(rng.choice(ODD[:7] + ODD[11:])),
            "[" * rng.randrange(200),
            "".join(rng.choices(string.printable, k=9)),
        ]
        load(cls, None, [f"{rng.choice(names)}={rng.choice(values)}" for _ in range(rng.randrange(1, 4))])


def command(ground: Ground, rng: random.Random) -> None:
    """A command line."""
    row = rng.choice(COMMANDS)
    words = row.name.split()
    for option in rng.sample(row.options, k=rng.randrange(len(row.options) + 1)):
        value = str(
            rng.choice(["", "-1", "0", "1e400", "nan", "x", "é" * 99, "/dev/null", "a,b", "k=v", "--out", "\x7f"])
        )
        words += [option.name, value] if option.name.startswith("-") else [value]
    if rng.random() < 0.2:
        rng.shuffle(words)
    given = parse(COMMANDS, GROUPS, [word for word in words if "\0" not in word])
    if given is not None and "workers" in given.values:
        given.workforce()


def log(ground: Ground, rng: random.Random) -> None:
    """A recording that was damaged."""
    source = rng.choice(sorted((ground.sweep / RECORDINGS).glob("*.mcap")))
    path = ground.place / "log.mcap"
    path.write_bytes(damage(source.read_bytes(), rng))
    reader = LogReader(path, load_topics("legtool"), load_geometry(LogSettings(robot="go2").robot).geometry())
    for _ in reader.recordings():
        pass


KINDS: dict[str, Callable[[Ground, random.Random], None]] = {
    "bundle": bundle, "dataset": dataset, "settings": settings, "command": command, "log": log,
}  # fmt: skip


def attempt(kind: str, ground: Ground, seed: int, number: int) -> str | None:
    """What was wrong with a case; None if nothing was."""
    rng = random.Random(f"{kind} {seed} {number}")
    begin, wrong = time.process_time(), None
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            KINDS[kind](ground, rng)
        except LegtoolError as error:
            text = str(error)
            if len(text) > LONGEST_MESSAGE:
                wrong = f"a message of {len(text)} characters: {text[:80]}…"
        except SystemExit as error:
            wrong = None if error.code in (0, 2, None) else f"exit code {error.code}"
        except Exception as error:
            wrong = f"{type(error).__name__}: {str(error)[:120]}"
    if time.process_time() - begin > LONGEST_S:
        wrong = f"{time.process_time() - begin:.1f} s of the processor"
    if Path(CANARY).exists():
        Path(CANARY).unlink()
        wrong = "code was run"
    return wrong


def campaign(kinds: list[str], count: int, seed: int, state: Path | None = None) -> dict[str, list[str]]:
    """Try so many cases of each kind, from where ``state`` says that they were stopped.

    Returns:
        by kind, what was wrong, a line for each case.
    """
    told: dict[str, Any] = json.loads(state.read_text()) if state is not None and state.is_file() else {}
    if told.get("seed", seed) != seed:
        raise SystemExit(f"{state}: is of seed {told['seed']}; name another file")
    done, found = told.get("done", {}), told.get("found", {})
    with tempfile.TemporaryDirectory() as place:
        sweep = Path(place) / "sweep"
        with contextlib.redirect_stderr(io.StringIO()):
            collect_sweep(SweepSettings(robot="go2", episodes=2, episode_s=12, seed=5), sweep)
        ground = Ground(sweep, Path(place))
        for kind in kinds:
            for number in range(done.get(kind, 0), count):
                if wrong := attempt(kind, ground, seed, number):
                    found.setdefault(kind, []).append(f"{number}: {wrong}")
                done[kind] = number + 1
                if state is not None and (number % 100 == 99 or number + 1 == count):
                    state.write_text(json.dumps({"seed": seed, "done": done, "found": found}))
    return {kind: found.get(kind, []) for kind in kinds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--state", type=Path)
    options = parser.parse_args()
    found = campaign(options.kinds.split(","), options.count, options.seed, options.state)
    for kind, lines in found.items():
        print(f"{kind}: {len(lines)} of {options.count} wrong", *lines[:20], sep="\n  ")
    sys.exit(any(found.values()))


if __name__ == "__main__":
    main()
