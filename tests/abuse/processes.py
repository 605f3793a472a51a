"""Attacks on running programs: kills, signals, silent and rude connections."""

import hashlib
import os
import random
import re
import shutil
import signal
import socket
import subprocess
import time

from judge import end_of, kill, start


def tree(folder):
    """Hash of each file of a folder, by name; what differs from run to run is left out."""
    names = (path for path in sorted(folder.rglob("*")) if path.is_file())
    kept = (path for path in names if path.name not in ("run.lock", "report.json", "report.html") and path.suffix != ".jsonl")
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in kept}


def kills(street, table, tries, seed):
    """Kills writers at random times: their outputs are old, whole or absent, and the next run sweeps what is left."""
    random_source = random.Random(f"{seed} kills")
    folder = street.out / "killed"
    for words in street.writers(folder):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        began = time.monotonic()
        end = end_of([street.program, *words])
        took_s = time.monotonic() - began
        table.judge("kills", f"{words[0]}, undisturbed", end.fault() or (None if end.code == 0 else end.said.strip()[-200:]))
        whole = tree(folder)
        for number in range(tries):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            child = start([street.program, *words])
            time.sleep(random_source.uniform(0, took_s))
            kill(child, random_source.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGINT]))
            # Each file under its own name is that of an undisturbed run.
            torn = [name for name, found in tree(folder).items() if not hidden(name) and whole.get(name) not in (None, found)]
            fault = f"torn: {torn[:3]}" if torn and words[0] != "drive" else None
            again = end_of([street.program, *words, *street.again(words)])
            left = [name for name in tree(folder) if hidden(name)]
            fault = fault or again.fault() or (None if again.code == 0 else f"the next run: {again.said.strip()[-200:]}")
            fault = fault or (f"other files than undisturbed" if tree(folder) != whole else None) or (f"left: {left[:3]}" if left else None)
            table.judge("kills", f"{words[0]}, try {number} of seed {seed}", fault)


def hidden(name):
    """True for what is being written under another name."""
    return any(part.startswith(".") for part in name.split(os.sep))


def address_of(child, pattern):
    """Port in the first line of a program that matches `pattern`; None if it ended before."""
    for line in child.stdout:
        found = re.search(pattern, line)
        if found:
            return found
    return None


def asked(port, data, wait_s=10.0):
    """The answer of a port to `data` within a time; b'' if it closes, None if it sends nothing."""
    with socket.create_connection(("127.0.0.1", port), timeout=wait_s) as connection:
        try:
            connection.sendall(data)
            return connection.recv(65536)
        except TimeoutError:
            return None
        except OSError:
            return b""


def viewer(street, table, tries, seed):
    """Raw requests to the viewer: none is answered with the page but its owner's, and floods pass."""
    child = start([street.program, "view", street.scene, "--port", "0"], stdout=subprocess.PIPE, text=True)
    try:
        found = address_of(child, r"http://127\.0\.0\.1:(\d+)/\S*?token=(\w+)")
        if found is None:
            table.judge("viewer", "start", "it printed no address with a token")
            return
        port, token = int(found[1]), found[2]
        host = f"Host: 127.0.0.1:{port}\r\n"
        page = f"GET /?token={token} HTTP/1.1\r\n{host}\r\n".encode()
        good = asked(port, page)
        table.judge("viewer", "its owner", None if good and good.split(b" ")[1] in (b"200", b"302", b"303", b"307") else f"answered {good!r:.80}")
        rude = {
            "no token": f"GET / HTTP/1.1\r\n{host}\r\n",
            "wrong token": f"GET /?token={token[:-1]}! HTTP/1.1\r\n{host}\r\n",
            "foreign host": f"GET /?token={token} HTTP/1.1\r\nHost: evil.example\r\n\r\n",
            "foreign origin": f"GET /socket?token={token} HTTP/1.1\r\n{host}Origin: http://evil.example\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
            "traversal": f"GET /../../etc/passwd?token={token} HTTP/1.1\r\n{host}\r\n",
            "encoded traversal": f"GET /%2e%2e/%2e%2e/etc/passwd?token={token} HTTP/1.1\r\n{host}\r\n",
            "two lengths": f"POST / HTTP/1.1\r\n{host}Content-Length: 4\r\nContent-Length: 40\r\n\r\nabcd",
            "long header": f"GET / HTTP/1.1\r\n{host}X: {'a' * 200_000}\r\n\r\n",
            "no HTTP": "\0\1\2\3" * 100 + "\r\n\r\n",
        }
        for name, request in rude.items():
            answer = asked(port, request.encode("latin-1"))
            shown = answer is not None and (answer.startswith((b"HTTP/1.1 200", b"HTTP/1.1 101")) or b"root:" in answer)
            table.judge("viewer", name, f"answered {answer!r:.80}" if shown else None)
        random_source = random.Random(f"{seed} viewer")
        for number in range(tries):
            data = bytearray(page)
            for _ in range(random_source.choice([1, 3, 10])):
                data[random_source.randrange(len(data))] = random_source.randrange(256)
            answer = asked(port, bytes(data) + b"\r\n\r\n")
            gives = answer is not None and answer.startswith(b"HTTP/1.1 200") and token.encode() not in data
            table.judge("viewer", f"damaged request {number}", "the page without its token" if gives else None)
        silent = [socket.create_connection(("127.0.0.1", port), timeout=10) for _ in range(300)]
        for connection in silent:
            try:
                connection.sendall(b"GET / HTTP/1.1\r\nHost: loc")
            except OSError:
                pass
        answers = any(asked_again(port, page) for _ in range(1))
        table.judge("viewer", "300 silent connections", None if answers else "its owner is locked out for 60 s")
        for connection in silent:
            connection.close()
        table.judge("viewer", "it still runs", None if child.poll() is None else f"it ended with {child.returncode}")
    finally:
        kill(child, signal.SIGINT)
    table.judge("viewer", "Ctrl-C", None if child.returncode == 0 else f"exit code {child.returncode}")


def asked_again(port, data):
    """True if the port answers within a minute."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        try:
            if asked(port, data, wait_s=5):
                return True
        except OSError:
            pass
        time.sleep(0.5)
    return False


def server(street, table, tries, seed):
    """Garbage to the server's port: it goes on, and answers its health check."""
    child = start([street.program.with_name("decouplegs-server"), "serve-grpc", street.scene, "--host", "127.0.0.1", "--port", "0"], stdout=subprocess.PIPE, text=True)
    try:
        found = address_of(child, r"127\.0\.0\.1:(\d+)")
        if found is None:
            table.judge("server", "start", "it printed no address")
            return
        port = int(found[1])
        preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
        settings = b"\0\0\0\4\0\0\0\0\0"
        random_source = random.Random(f"{seed} server")
        for number in range(tries):
            length = random_source.choice([0, 5, 100, 20_000])
            garbage = random_source.randbytes(length)
            head = random_source.choice([b"", preface, preface + settings, b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\x02\x00"])
            asked(port, head + garbage, wait_s=1.0)
            table.judge("server", f"garbage {number}", None if child.poll() is None else f"it ended with {child.returncode}")
            if child.poll() is not None:
                return
        answer = asked(port, preface + settings, wait_s=20.0)
        table.judge("server", "it answers a client afterwards", None if answer else "it does not")
    finally:
        kill(child, signal.SIGTERM)
    table.judge("server", "SIGTERM", None if child.returncode == 0 else f"exit code {child.returncode}")


def planners(street, table):
    """Planners that misbehave: each ends its episode with a reason, and nothing else."""
    folder = street.out / "planners"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    bodies = {
        "silent": "sleep 1000",
        "ends": "exit 3",
        "garbage": "head -c 100000 /dev/urandom",
        "endless": "yes '{\"plan\": 1}'",
        "errors": "yes oops >&2 & cat >/dev/null",
        "nothing": "true",
        "escape": "printf '\\033[31m\\342\\200\\256evil' >&2; exit 1",
    }
    for name, body in bodies.items():
        script = folder / f"{name}.sh"
        script.write_text(body + "\n")
        words = ["drive", "--level", "easy", "--episodes", "1", "--scene", street.scene, "--map", street.lanes, "--render", "off", "--planner", f"exec:sh {script}", "--out", folder / name]
        end = end_of([street.program, *words])
        fault = end.fault()
        if fault is None and end.code == 0 and not list(folder.glob(f"{name}/logs/*")):
            fault = "there is neither an error nor a log of the episode"
        table.judge("planners", name, fault)
