"""A planner that keeps to the protocol but for one thing, the word in its first argument."""

import json
import os
import signal
import sys
import time

WAY = sys.argv[1]
PLAN = {"points": [[0.5, 5.0, 0.0], [1.0, 10.0, 0.0]]}
reading, writing = sys.stdin.buffer, sys.stdout.buffer


def say(message):
    writing.write(message if isinstance(message, bytes) else json.dumps(message).encode() + b"\n")
    writing.flush()


def misbehave(step):
    if WAY == "late":
        time.sleep(60)
    elif WAY == "dribbling":
        while True:
            say(b"x")
            time.sleep(0.02)
    elif WAY == "crashing":
        print("Traceback: out of memory\nat layer 7", file=sys.stderr)
        sys.exit(3)
    elif WAY == "complaining":
        sys.stderr.write("noise\n" * 200_000 + "the last word\n")
        sys.exit(4)
    elif WAY == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    elif WAY == "babbling":
        while True:
            say(b"babble " * 1000)
    elif WAY == "closing":
        os.close(1)
        time.sleep(60)
    elif WAY == "interrupting":
        say({"type": "plan", "step": step, **PLAN})
        say({"type": "plan", "step": step + 1, **PLAN})
        time.sleep(60)
    say({
        "nan": {"type": "plan", "step": step, "points": [[0.5, float("nan"), 0.0]]},
        "infinity": {"type": "plan", "step": step, "points": [[0.5, float("inf"), 0.0]]},
        "overflowing": f'{{"type": "plan", "step": {step}, "points": [[0.5, 1e999, 0.0]]}}\n'.encode(),
        "far": {"type": "plan", "step": step, "points": [[0.5, 1e9, 0.0]]},
        "huge": {"type": "plan", "step": step, "points": [[0.001 * i, 1.0, 0.0] for i in range(1, 1500)]},
        "huger": {"type": "plan", "step": step, "points": [[0.001 * i, 1.0, 0.0] for i in range(1, 100_000)]},
        "backwards": {"type": "plan", "step": step, "points": [[1.0, 1.0, 0.0], [0.5, 2.0, 0.0]]},
        "empty": {"type": "plan", "step": step, "points": []},
        "flat": {"type": "plan", "step": step, "points": [[0.5, 1.0]]},
        "wordy": {"type": "plan", "step": step, "points": [["soon", 1.0, 0.0]]},
        "pointless": {"type": "plan", "step": step},
        "stale": {"type": "plan", "step": step + 7, **PLAN},
        "wrong": {"type": "ready"},
        "unknown": {"type": "dance"},
        "junk": b"Loading model weights...\n",
        "binary": b"\xff\xfe\x00\n",
        "nested": b"[" * 60_000 + b"\n",
        "laden": {"type": "plan", "step": step, "bytes": 1 << 40, **PLAN},
        "giving-up": {"type": "fail", "reason": "the road \u001b[31mends"},
    }[WAY])


say({"type": "hello", "protocol": 2 if WAY == "modern" else 1, "name": WAY, "cameras": "front", "privileged": False}
    if WAY != "mute" else b"")
for line in iter(reading.readline, b""):
    header = json.loads(line)
    if header["type"] == "begin":
        say({"type": "ready"})
        if WAY == "deaf":
            time.sleep(60)
    elif header["type"] == "observe":
        reading.read(header["bytes"])
        if header["step"] == 0:
            say({"type": "plan", "step": 0, **PLAN})
        else:
            misbehave(header["step"])
    elif header["type"] == "end":
        sys.exit(0)
