"""How fast a long MCAP is read into recordings on one core, in how much memory, beside rosbags' own decoder.

The file holds what ``collect sweep`` writes, at 200 Hz, and a camera that nobody asked for. Run it with
``python benchmarks/read_log.py``; ``--minutes`` sets the length, and a file four times as long shows that the peak
memory does not grow with it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RATE = 200
IMAGE_BYTES = 200_000
IMAGE_HZ = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--read", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read is not None:
        print(json.dumps(measure(options.read, options.repeats)))
        return
    with tempfile.TemporaryDirectory() as folder:
        for minutes, repeats in ((options.minutes, options.repeats), (4 * options.minutes, 1)):
            path = Path(folder) / f"{minutes:g}.mcap"
            count = generate(path, minutes)
            # A process of its own, held to one core: its peak memory is that of reading alone.
            command = [sys.executable, __file__, "--read", str(path), "--repeats", str(repeats)]
            environment = {**os.environ, "OMP_NUM_THREADS": "1"}
            told = json.loads(subprocess.run(command, check=True, capture_output=True, env=environment).stdout)
            report(path, minutes, count, told)
        print(f"rosbags AnyReader, the same topics deserialised: {anyreader(path):,.0f} messages/s")


def report(path: Path, minutes: float, count: int, told: dict) -> None:
    import numpy as np

    seconds = np.array(told["seconds"])
    print(f"{minutes:g} min, {path.stat().st_size / 2**20:.0f} MiB, {count:,} messages of the topics that are read:")
    if len(seconds) > 1:
        middle, p95, p99 = (count / np.quantile(seconds, q) for q in (0.5, 0.95, 0.99))
        print(f"  median {middle:,.0f}, p95 {p95:,.0f}, p99 {p99:,.0f} messages/s over {len(seconds)} repeats")
    else:
        print(f"  {count / seconds[0]:,.0f} messages/s, once")
    print(f"  peak memory {told['peak_mib']:.0f} MiB, of which {told['base_mib']:.0f} MiB before reading")


def measure(path: Path, repeats: int) -> dict:
    """Read the file again and again, checking each time that it is all there and right."""
    import numpy as np

    from legtool.configs.robots import load_robot
    from legtool.configs.topics import load_topics
    from legtool.datasets.logs.log import read_log

    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    robot, topics = load_robot("aliengo").geometry(), load_topics("legtool")
    next(read_log(path, topics, robot, chunk_s=2.0))  # warm-up: imports, compiled kernels
    base = peak_mib()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        rows, wrong = 0, 0
        for recording in read_log(path, topics, robot):
            stamps = np.arange(rows, rows + len(recording)) * (10**9 // RATE)
            t = stamps * 1e-9
            wrong += int((recording.stamps_ns != stamps).sum() + (recording.position_world[:, 0] != 0.4 * t).sum())
            rows += len(recording)
        seconds.append(time.perf_counter() - start)
        with path.with_suffix(".rows").open() as file:
            assert rows == int(file.read()) and wrong == 0, "what was read is not what was written"
    peak = peak_mib()
    return {"seconds": seconds, "base_mib": base, "peak_mib": peak}


def peak_mib() -> float:
    """This process's own peak; getrusage would tell its parent's, if that was larger."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def generate(path: Path, minutes: float) -> int:
    """Write a walk and a camera; returns the count of messages but the camera's."""
    import numpy as np
    from mcap.reader import make_reader
    from mcap.writer import Writer

    from legtool.configs.robots import load_robot
    from legtool.datasets.logs.mcap_writer import definition, write_mcap
    from legtool.datasets.logs.recording import Recording

    robot = load_robot("aliengo").geometry()
    stamps = np.arange(int(minutes * 60 * RATE)) * (10**9 // RATE)
    t = stamps * 1e-9
    n = len(t)
    joints = robot.joints(robot.stance)[0].reshape(12) + 0.1 * np.sin(9 * t[:, None] + np.arange(12))
    forward = np.stack([0.4 + 0 * t, 0 * t, 0 * t], axis=1)
    walk = Recording(
        name="walk",
        stamps_ns=stamps,
        position_world=np.stack([0.4 * t, 0 * t, 0.38 + 0 * t], axis=1),
        orientation=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        velocity_base=forward,
        yaw_rate=0.01 * np.sin(t),
        command=forward,
        feet_base=robot.feet(joints),
        contact_force=60 + 50 * np.sin(9 * t[:, None] + np.array([0, np.pi, np.pi, 0])),
    )
    plain = path.with_suffix(".plain")
    write_mcap(plain, walk, joint_positions=joints, metadata={})
    path.with_suffix(".rows").write_text(str(n))
    pixels = np.random.default_rng(0).integers(0, 16, IMAGE_BYTES, dtype=np.uint8).tobytes()
    every = 10**9 // IMAGE_HZ
    with plain.open("rb") as source, path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "benchmark")
        image = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", definition("sensor_msgs/msg/Image").encode())
        camera = writer.register_channel("/camera", "cdr", image)
        channels: dict[int, int] = {}
        due = 0
        count = 0
        for schema, channel, message in make_reader(source).iter_messages(log_time_order=False):
            if channel.id not in channels:
                made = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", made)
            if message.log_time >= due:
                writer.add_message(camera, due, bytes(4) + pixels, due)
                due += every
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
            count += 1
        writer.finish()
    plain.unlink()
    return count


def anyreader(path: Path) -> float:
    """Messages/s that rosbags deserialises, over the first seconds of the file."""
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic != "/camera"]
        start, count = time.perf_counter(), 0
        for connection, _, raw in reader.messages(wanted):
            reader.deserialize(raw, connection.msgtype)
            count += 1
            if count == 100_000:
                break
        return count / (time.perf_counter() - start)


if __name__ == "__main__":
    main()
