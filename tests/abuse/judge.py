"""Runs commands that are attacked, and judges how they end.

A command ends well with exit code 0, 1 or 2, in time, within its memory, and with lines that a person can read. It never panics, and
never ends by a signal that it was not sent.
"""

import dataclasses
import os
import resource
import signal
import subprocess
import time

# Address space of a command, bytes: readers ask for memory before they use it, and are refused.
MEMORY_BYTES = 6 << 30

# Seconds of processor time that a command may take, and of the clock: the second is for a busy machine.
PROCESSOR_S = 60
CLOCK_S = 300

# Longest line of a message, bytes, with the name of its program and a path.
LINE_BYTES = 1000


@dataclasses.dataclass
class End:
    """The end of a command: exit code, messages and time."""

    code: int
    said: str
    clock_s: float

    def fault(self):
        """The fault of the end; None for a good one."""
        if self.code is None:
            return f"it did not end in {CLOCK_S} s"
        if self.code < 0:
            return f"it ended by signal {signal.Signals(-self.code).name}"
        if self.code not in (0, 1, 2):
            return f"exit code {self.code}"
        if "panicked" in self.said or "RUST_BACKTRACE" in self.said:
            return "it panicked"
        if self.code and not self.said.strip():
            return f"exit code {self.code} without a word"
        longest = max((len(line.encode()) for line in self.said.splitlines()), default=0)
        if longest > LINE_BYTES:
            return f"a line of {longest} bytes"
        raw = [character for character in self.said if (ord(character) < 32 and character not in "\n\t\r") or "\u202a" <= character <= "\u202e"]
        if raw:
            return f"a raw control character {raw[0]!r}"
        return None


def limits(file_bytes=None):
    """Limits of a child, set before it starts."""

    def set_limits():
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, PROCESSOR_S))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if file_bytes is not None:
            # A write beyond the limit then fails as on a full disk, and is no signal.
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))

    return set_limits


def start(command, **options):
    """Starts a command in a group of processes of its own."""
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen([str(word) for word in command], start_new_session=True, **(quiet | options))


def end_of(command, file_bytes=None, cwd=None):
    """Runs a command to its end."""
    began = time.monotonic()
    child = start(command, stderr=subprocess.PIPE, preexec_fn=limits(file_bytes), cwd=cwd)
    try:
        said = child.communicate(timeout=CLOCK_S)[1]
        code = child.returncode
    except subprocess.TimeoutExpired:
        kill(child)
        said, code = b"", None
    return End(code, said.decode(errors="replace"), time.monotonic() - began)


def kill(child, by=signal.SIGKILL):
    """Sends a signal to a command and its children, and waits for it."""
    try:
        os.killpg(child.pid, by)
    except ProcessLookupError:
        pass
    child.wait()


class Table:
    """Counts of tries and findings, by attack."""

    def __init__(self, verbose):
        self.tried = {}
        self.findings = []
        self.verbose = verbose

    def judge(self, attack, name, fault):
        """Counts a try; `fault` says what was wrong, None for nothing."""
        self.tried[attack] = self.tried.get(attack, 0) + 1
        if fault:
            self.findings.append((attack, name, fault))
            print(f"FOUND {attack}: {name}: {fault}", flush=True)
        elif self.verbose:
            print(f"{attack}: {name}", flush=True)

    def text(self):
        """A line for each attack."""
        found = [attack for attack, _, _ in self.findings]
        lines = [f"{attack:32} {tries:6} tries {found.count(attack):4} findings" for attack, tries in self.tried.items()]
        return "\n".join([*lines, f"{'all':32} {sum(self.tried.values()):6} tries {len(found):4} findings"])
